"""A story as one HTML page that needs nothing else: renderer, style and data are in it. The parts lie in `web/`."""

import base64
from importlib import resources

SCRIPTS = ("maths", "solids", "painter", "story", "stage", "camera", "charts", "page")
LIVE = "feed"
"""What the page of a server has beside them: it listens to what the server tells."""


def page(packed: bytes, live: bool = False) -> str:
    """The page of a packed story (`story.pack`). live: it asks the server it comes from for news."""
    scripts = [_text(f"{name}.js") for name in (*SCRIPTS, *([LIVE] if live else []))]
    parts = {
        "style": _text("style.css"),
        "story": base64.b64encode(packed).decode(),
        "script": "\n".join(scripts),
    }
    out = _text("page.html")
    for name, text in parts.items():
        out = out.replace(f"{{{{{name}}}}}", text)
    return out


def _text(name: str) -> str:
    return resources.files("regrasp.view").joinpath("web", name).read_text("utf-8")
