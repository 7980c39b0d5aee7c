"""Judging a plan: its certificate, and what physics makes of it."""

from pathlib import Path
from typing import Annotated

from regrasp.commands.line import DONE, REFUSED, Answer, drawable, parse, say
from regrasp.errors import InputError


def check(arguments: list[str]) -> Answer:
    import tyro

    def request(plan: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="PLAN")]) -> Path:
        """Read the command line.

        Args:
            plan: Plan file, as `regrasp plan` writes it.
        """
        return plan

    path = parse(request, "check", arguments)
    from regrasp.plan import load
    from regrasp.verify.check import check

    certificate = check(load(path))
    for finding in certificate.refusals:
        say(f"{path}: refused: {finding}")
    return (DONE if certificate.passed else REFUSED), {"plan": str(path), **certificate.to_dict()}


def replay(arguments: list[str]) -> Answer:
    import tyro

    from regrasp.control.controller import Control
    from regrasp.plan import load
    from regrasp.verify.replay import control_of, replay
    from regrasp.verify.trials import Perturbation

    def request(
        plan: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="PLAN")],
        control: Control,
        perturbation: Perturbation,
        trials: int = 0,
        seed: int = 0,
        cores: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: all)")] = None,
        output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="FILE")] = None,
    ) -> tuple[Path, Control, Perturbation, int, int, int | None, Path | None]:
        """Read the command line.

        Args:
            plan: Plan file, as `regrasp plan` writes it.
            control: How the robots are controlled; replaces what the scene says.
            perturbation: Ranges of the perturbed trials.
            trials: Perturbed executions in each mode.
            seed: Seed of the trials; the result does not depend on the number of cores.
            cores: Processes that share the trials.
            output: Picture (.png) or clip (.gif, .mp4) of the execution with object feedback to write.
        """
        return plan, control, perturbation, trials, seed, cores, output

    def asked(control: Control) -> tuple[Path, Control, Perturbation, int, int, int | None, Path | None]:
        request.__defaults__ = (control, Perturbation(), 0, 0, None, None)
        return parse(request, "replay", arguments)

    # The scene's settings are the defaults of the flags, so the plan is read first.
    path, *_ = asked(Control())
    found = load(path)
    _, control, ranges, trials, seed, cores, output = asked(control_of(found))
    for name, value in (("--trials", trials), ("--cores", 1 if cores is None else cores - 1)):
        if value < 0:
            raise InputError(
                name, f"is {value + (name == '--cores')}", "0 or more" if name == "--trials" else "1 or more"
            )
    if output is not None:
        drawable(output)
    result = replay(found, trials, seed, control, ranges, cores)
    answer = {"plan": str(path), **result.to_dict()}
    if output is not None:
        from regrasp.view import clip
        from regrasp.view.film import prepare, replayed

        shown = result.nominal[-1]
        film = prepare(found, shown.run)
        if output.suffix.lower() == ".png":
            replayed(film, shown.tolerance, shown.tube).save(output)
        else:
            clip.write(film, output)
        answer["picture"] = str(output)
    for each in result.nominal:
        if not each.passed:
            say(f"{path}: {each.mode}: {each.failure or 'reaches the goal, but leaves the tube on its way'}")
    return (DONE if result.passed else REFUSED), answer
