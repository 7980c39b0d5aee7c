"""Every built-in scene planned, checked, drawn and filmed: python -m pages.gallery [SCENE ...]

Pictures and clips go to docs/img, the page to docs/gallery.md. Scenes named are made anew, the others are kept.
"""

import json
import sys
from pathlib import Path
from typing import Any

from PIL import Image

from regrasp.plan import RELOCATE, Plan
from regrasp.planner.method import plan_scene
from regrasp.planner.task import Settings
from regrasp.scene.load import builtin, load
from regrasp.settings import read
from regrasp.verify.check import check
from regrasp.view import clip, planned
from regrasp.view.figure import figure, save
from regrasp.view.ink import AGENT_FORCE, AGENTS, SUPPORT_FORCE
from regrasp.view.render import render

DOCS = Path(__file__).parents[1] / "docs"
SEED = 0
FIRST = "fig4-relocation"
"""Whose clip is the moving picture of the first page, and whose figure explains figures."""
WIDTH = 1100
"""Of a picture, px."""
HEAD = """# Gallery

Every built-in scene, planned with seed {seed} and its file's settings, checked, drawn and filmed: what `make gallery` makes.
A picture is what `regrasp render PLAN -o FILE.png` draws, a clip what `-o FILE.mp4` films; [how to read them](reading.md).

"""


def make(name: str) -> dict[str, Any]:
    """Plan, check, draw and film one scene; the facts for its lines of the page."""
    scene = load(name)
    plan = plan_scene(scene, SEED, read(Settings, scene.planner)).plan
    if plan is None:
        return {"planned": False}
    small(render(plan)).save(DOCS / "img" / f"{name}.png", optimize=True)
    reel = planned.prepare(plan)
    clip.write(reel, DOCS / "img" / f"{name}.mp4")
    if name == FIRST:
        clip.write(reel, DOCS / "img" / f"{name}.gif")
        small_figure(plan, DOCS / "img" / "figure.png")
    return facts(plan)


def small_figure(plan: Plan, path: Path) -> None:
    """The figure of a plan."""
    save(figure(plan), path)
    with Image.open(path) as whole:
        few = small(whole.convert("RGB"))
    few.save(path, optimize=True)


def small(picture: Image.Image) -> Image.Image:
    """A picture as wide as a page, in few colours: a repository keeps it for ever."""
    size = (WIDTH, round(picture.height * WIDTH / picture.width))
    fitted = picture.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    return clip.in_few_colours([fitted], (AGENT_FORCE, SUPPORT_FORCE, *AGENTS))[0]


def facts(plan: Plan) -> dict[str, Any]:
    """What the page tells of a plan."""
    told = plan.summary()
    return {
        "planned": True, "certified": check(plan).passed, "intervals": told["intervals"],
        "relocations": int((plan.V == RELOCATE).sum()), "duration": round(told["duration"], 1),
        "force": round(told["largest_force"], 2),
    }  # fmt: skip


def page(found: dict[str, dict[str, Any]]) -> str:
    """The page, in Markdown: for each scene its words, facts, picture and clip."""
    lines = [HEAD.format(seed=SEED)]
    for name, words in builtin().items():
        made = found[name]
        lines.append(f"## {name}\n\n{words.strip()}\n\n")
        if not made["planned"]:
            lines.append("No plan was found.\n\n")
            continue
        film = DOCS / "img" / f"{name}.mp4"
        relocations = f"{made['relocations']} relocation{'s' * (made['relocations'] != 1)}"
        lines.append(
            f"{'Certified' if made['certified'] else '**Refused by `check`**'}: {made['intervals']} intervals, "
            f"{relocations}, {made['duration']:g} s of motion, at most {made['force']:g} N from one agent.\n\n"
            f"![{name}: frames of the plan, and its V](img/{name}.png)\n\n"
        )
        if film.exists():
            lines.append(
                f"[Clip](img/{name}.mp4)\n\n"
                f'<video src="img/{name}.mp4" controls loop muted playsinline preload="none" width="640"></video>\n\n'
            )
    return "".join(lines).rstrip() + "\n"


def main(names: list[str]) -> None:
    """Make what is named, or all, and the page."""
    kept = DOCS / "img" / "gallery.json"
    found = json.loads(kept.read_text()) if kept.exists() else {}
    for name in names or builtin():
        found[name] = make(name)
        print(name, found[name], file=sys.stderr, flush=True)
        kept.write_text(json.dumps(found, indent=1) + "\n")
    if set(found) == set(builtin()):
        (DOCS / "gallery.md").write_text(page(found), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
