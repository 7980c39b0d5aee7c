"""The page of a scene file's fields, made from the schema that reads it."""

import json
from collections.abc import Iterator, Mapping
from typing import Any

from regrasp.scene.schema import Scene

HEAD = """# Every field of a scene file

Made from the code by `python -m pages`: the fields of each part of a scene file, what is legal, and the default. What
they mean is told in [scene files](scenes.md). A default of – means: none, or what the model or the scene says.

"""


def page() -> str:
    """The page, in Markdown: the scene first, then its parts as they are first named."""
    whole = Scene.model_json_schema()
    parts = {"Scene": whole, **whole["$defs"]}
    order: list[str] = []
    waiting = ["Scene"]
    while waiting:
        name = waiting.pop(0)
        if name not in order:
            order.append(name)
            waiting = [*dict.fromkeys(_named(parts[name]["properties"])), *waiting]
    return HEAD + "\n".join(_section(name, parts[name]) for name in order)


def _section(name: str, part: Mapping[str, Any]) -> str:
    """Heading, words and table of one part."""
    rows = [f"| `{key}` | {legal(field)} | {_default(key, field, part)} |" for key, field in part["properties"].items()]
    words = " ".join(part.get("description", "").split())
    return "\n".join([f"## {name}\n", f"{words}\n", "| key | legal | default |", "|---|---|---|", *rows, ""])


def legal(field: Mapping[str, Any]) -> str:
    """What a field may be, in words, as Markdown for a cell of a table."""
    if "$ref" in field:
        name = field["$ref"].rsplit("/", 1)[1]
        return f"[{name}](#{name.lower()})"
    if choices := field.get("anyOf") or field.get("oneOf"):
        return " or ".join(dict.fromkeys(legal(choice) for choice in choices if choice.get("type") != "null"))
    if "const" in field or "enum" in field:
        return ", ".join(f"`{value}`" for value in field.get("enum") or [field["const"]])
    kind = field.get("type")
    if kind == "array":
        if items := field.get("prefixItems"):
            return f"list of {len(items)}: {legal(items[0])}"
        least = f", at least {field['minItems']}" if field.get("minItems") else ""
        return f"list of {legal(field['items'])}{least}"
    if kind == "object":
        values = field.get("additionalProperties")
        if isinstance(values, Mapping):
            keys = field.get("propertyNames", {})
            return f"{legal(keys) if keys else 'name'} → {legal(values)}"
        return "section of settings"
    if kind == "integer":
        return f"whole number, {field['minimum']} to {field['maximum']}"
    if kind == "number":
        return f"number {field['description']}".replace("|", "\\|")
    return {"string": "text", "boolean": "true or false"}[str(kind)]


def _default(key: str, field: Mapping[str, Any], part: Mapping[str, Any]) -> str:
    if key in part.get("required", ()):
        return "required"
    value = field.get("default")
    if isinstance(value, Mapping):
        value = {k: v for k, v in value.items() if v is not None}
    return "–" if value in (None, "", [], {}) else f"`{json.dumps(value, ensure_ascii=False)}`"


def _named(node: Any) -> Iterator[str]:
    """Names of the parts that a schema refers to, in order."""
    if isinstance(node, Mapping):
        if "$ref" in node:
            yield node["$ref"].rsplit("/", 1)[1]
        for value in node.values():
            yield from _named(value)
    elif isinstance(node, list):
        for value in node:
            yield from _named(value)
