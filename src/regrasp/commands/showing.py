"""Showing what there is: scenes, models, what is wrong with them, pictures of plans."""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

from regrasp.commands.line import DONE, REFUSED, Answer, drawable, parse, writable
from regrasp.errors import InputError


def scenes(arguments: list[str]) -> Answer:
    def request() -> None:
        """Read the command line."""

    parse(request, "scenes", arguments)
    from regrasp.scene.load import builtin

    return DONE, {"scenes": [{"name": name, "description": words} for name, words in builtin().items()]}


def models(arguments: list[str]) -> Answer:
    def request() -> None:
        """Read the command line."""

    parse(request, "models", arguments)
    from regrasp.scene import menagerie, models

    return DONE, {"hands": models.hands(), "menagerie": list(menagerie.names()), "root": menagerie.root()}


def doctor(arguments: list[str]) -> Answer:
    import tyro

    def request(model: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE|MODEL")]) -> str:
        """Read the command line.

        Args:
            model: A scene (built-in name or path), or a robot: path of an MJCF or URDF file, name in the menagerie.
        """
        return model

    name = parse(request, "doctor", arguments)
    from regrasp.scene.doctor import examine

    diagnosis = examine(name)
    return (DONE if diagnosis.healthy else REFUSED), {"examined": name, **dataclasses.asdict(diagnosis)}


def render(arguments: list[str]) -> Answer:
    import tyro

    def request(
        plan: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="PLAN")],
        output: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="FILE")],
        frames: int = 6,
    ) -> tuple[Path, Path, int]:
        """Read the command line.

        Args:
            plan: Plan file, as `regrasp plan` writes it.
            output: Picture (.png: frames side by side) or clip (.gif, .mp4) to write.
            frames: Number of instants that a picture shows, 1 to 12.
        """
        return plan, output, frames

    path, output, frames = parse(request, "render", arguments)
    drawable(output)
    if not 1 <= frames <= 12:
        raise InputError("--frames", f"is {frames}", "1 to 12")
    from regrasp.plan import load
    from regrasp.view import clip, planned
    from regrasp.view.render import render

    found = load(path)
    if output.suffix.lower() == ".png":
        picture = render(found, frames)
        picture.save(output)
        return DONE, {"picture": str(output), "width": picture.width, "height": picture.height}
    return DONE, {"clip": str(output), "pictures": clip.write(planned.prepare(found), output)}


def plot(arguments: list[str]) -> Answer:
    import tyro

    def request(
        plan: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="PLAN")],
        output: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="FILE")],
        what: tuple[Literal["V", "energy", "forces", "joints", "clearances"], ...] = (
            "V",
            "energy",
            "forces",
            "joints",
            "clearances",
        ),
    ) -> tuple[Path, Path, tuple[str, ...]]:
        """Read the command line.

        Args:
            plan: Plan file, as `regrasp plan` writes it.
            output: Figure to write: .pdf, .svg or .png.
            what: Panels, from top to bottom.
        """
        return plan, output, what

    path, output, what = parse(request, "plot", arguments)
    if output.suffix.lower() not in (".pdf", ".svg", ".png"):
        raise InputError("--output", f"{output} is no .pdf, .svg or .png file", "what papers and pages take")
    if not what:
        raise InputError("--what", "names no panel", "V, energy, forces, joints, clearances")
    writable(output)
    from regrasp.plan import load
    from regrasp.view.figure import figure, save

    save(figure(load(path), what), output)
    return DONE, {"figure": str(output), "panels": list(what)}
