"""Scene files read and written: from a built-in name or a YAML file to a checked `Scene`, and back to YAML."""

import difflib
import re
import typing
from collections.abc import Iterable, Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ValidationError

from regrasp.errors import InputError
from regrasp.scene.forms import MODELS, ModelFile
from regrasp.scene.schema import OBJECTS, MeshObject, Scene

# What a wrong type is called where a scene's reader would not know pydantic's name for it.
_TYPES = {
    "tuple_type": "is not a list",
    "dict_type": "is not a mapping",
    "model_type": "is not a mapping",
    "string_type": "is not a text",
    "bool_parsing": "is neither true nor false",
    "int_parsing": "is not a whole number",
}


class Loader(yaml.SafeLoader):
    """Safe YAML in which only true and false are booleans, as in YAML 1.2: `off` is a key of scenes.

    A key written twice is an error, where plain YAML would silently take the last.
    """

    yaml_implicit_resolvers = {  # noqa: RUF012 - the base class declares it so
        first: [(tag, pattern) for tag, pattern in resolvers if not tag.endswith(":bool")]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key, _ in node.value:
            if key.value in seen:
                raise yaml.constructor.ConstructorError(None, None, f"{key.value!r} is written twice", key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


Loader.add_implicit_resolver("tag:yaml.org,2002:bool", re.compile("^(?:true|false)$"), ["t", "f"])


def builtin() -> dict[str, str]:
    """Name → description of every built-in scene."""
    return {name: yaml.load(text, Loader)["description"] for name, text in sorted(_texts())}


def load(name_or_path: str | Path) -> Scene:
    """The scene of a built-in name, or of a YAML file (anything with a suffix or a slash is a path).

    Files named in the scene count from the scene file's directory. Raises InputError: its line names the first
    wrong field, its `others` hold all further ones.
    """
    name = str(name_or_path)
    path = Path(name_or_path)
    builtins = dict(_texts())
    if name in builtins:
        return parse(builtins[name], name)
    if not path.suffix and "/" not in name and not path.exists():
        near = difflib.get_close_matches(name, builtins, n=1, cutoff=0.4)
        guess = f"{near[0]}? " if near else ""
        raise InputError("scene", f"no built-in scene {name!r}", f"{guess}legal: {', '.join(builtins)}, or a YAML file")
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise InputError("scene", "is not UTF-8 text", "a scene is a YAML file", name) from None
    except OSError as error:
        raise InputError("scene", error.strerror or "cannot be read", "a built-in name or a YAML file", name) from None
    return parse(text, name, path.resolve().parent)


def parse(text: str, file: str = "", directory: Path | None = None) -> Scene:
    """The scene in a YAML text; `file` is what errors call it, `directory` where relative file names count from."""
    try:
        data = yaml.load(text, Loader)
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}" if error.problem_mark else "YAML"
        raise InputError(line, error.problem or "not YAML", "check indentation, colons and brackets", file) from None
    except yaml.YAMLError as error:
        raise InputError("YAML", str(error).splitlines()[0], "a scene is a YAML file", file) from None
    scene = validate(data, file)
    return scene if directory is None else _placed(scene, directory)


def _placed(scene: Scene, directory: Path) -> Scene:
    """The scene with the files it names counted from the directory."""

    def found(part: Any, **others: Any) -> Any:
        return part.model_copy(update={"file": str(directory / part.file), **others})

    model = scene.model
    if isinstance(model, ModelFile):
        model = found(model, packages={name: str(directory / folder) for name, folder in model.packages.items()})
    thing = found(scene.object) if isinstance(scene.object, MeshObject) else scene.object
    bodies = tuple(found(body) if body.file else body for body in scene.environment)
    return scene.model_copy(update={"model": model, "object": thing, "environment": bodies})


def validate(data: Any, file: str = "") -> Scene:
    """The scene in plain data (`Scene.model_dump(mode="json")` gives such); raises InputError with every fault."""
    if not isinstance(data, dict):
        raise InputError("scene", "is not a mapping", "key: value lines such as name: my-scene", file)
    try:
        return Scene.model_validate(data)
    except ValidationError as error:
        first, *others = (InputError(*fault, file=file) for fault in _faults(error))
        raise InputError(first.field, first.reason, first.hint, file, others) from None


def dump(scene: Scene) -> str:
    """The scene as YAML text; `parse` gives it back."""
    return yaml.safe_dump(scene.model_dump(mode="json", exclude_defaults=True), sort_keys=False, allow_unicode=True)


def _texts() -> Iterator[tuple[str, str]]:
    for entry in sorted(
        resources.files("regrasp.scene").joinpath("builtin").iterdir(), key=lambda entry: Path(entry.name).stem
    ):
        if entry.name.endswith(".yaml"):
            yield entry.name.removesuffix(".yaml"), entry.read_text(encoding="utf-8")


def _faults(error: ValidationError) -> Iterator[tuple[str, str, str]]:
    """Field path, reason and hint of every fault pydantic found."""
    for item in error.errors(include_url=False):
        path = [part for part in item["loc"] if ": " not in str(part)]
        field = ".".join(map(str, path)) or "scene"
        context = item.get("ctx", {})
        match item["type"]:
            case "scenes":
                yield from context["problems"]
            case "scene":
                yield field, context.get("reason", item["msg"]), context["hint"]
            case "missing":
                yield field, "missing", "required"
            case "extra_forbidden":
                keys = _keys(item["loc"][:-1])
                near = difflib.get_close_matches(str(path[-1]), keys, n=1)
                yield field, "unknown key", f"{near[0]}?" if near else f"legal: {', '.join(keys)}"
            case "literal_error":
                yield field, f"{item['input']!r} is not legal", f"legal: {context['expected']}"
            case "string_pattern_mismatch":
                yield (
                    field,
                    f"{item['input']!r} is not a name",
                    "letters, digits, - and _, starting with a letter or digit",
                )
            case kind if kind in _TYPES:
                yield field, f"{_short(item['input'])} {_TYPES[kind]}", ""
            case _:
                yield field, item["msg"][0].lower() + item["msg"][1:], f"got {_short(item['input'])}"


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _keys(path: Iterable[str | int]) -> list[str]:
    """The legal keys at a path of pydantic's: its model is found by following the schema's annotations along it."""
    models: list[type[BaseModel]] = [Scene]
    tagged = {**MODELS, **OBJECTS}
    for part in path:
        if isinstance(part, str) and part in tagged:
            models = [tagged[part]]
        elif isinstance(part, str) and ": " not in part:
            annotations = [model.model_fields[part].annotation for model in models if part in model.model_fields]
            models = [found for annotation in annotations for found in _models(annotation)]
    return [key for model in models for key in model.model_fields]


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [found for argument in typing.get_args(annotation) for found in _models(argument)]
