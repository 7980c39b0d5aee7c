"""The answers of the command line's commands as text on stdout, for people."""

import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table

JSON = "--json: print one JSON object on stdout instead of text."


def plan(answer: dict[str, Any]) -> None:
    """The plan's counts, and the use of each contact motion."""
    if "plan" not in answer:
        return
    motions = ", ".join(f"{count} {name}" for name, count in answer["motions"].items())
    found = ", ".join(f"{a} of {b}" for a, b in zip(answer["found_after"], answer["evaluations"], strict=True))
    print(
        f"{answer['plan']}: {answer['intervals']} intervals, {len(answer['agents'])} agents, "
        f"{answer['duration']:.3g} s of motion, energy {answer['energy']:.4g}, "
        f"{'feasible' if answer['feasible'] else 'NOT feasible'}; "
        f"planned in {answer['seconds']:.2f} s with seed {answer['seed']}\n"
        f"best V of each segment found after: {found} evaluations\n"
        f"contact motions: {motions}"
    )
    for arc in answer["arcs"]:
        print(f"arc: {arc}")
    for remark in answer["remarks"]:
        print(remark)


def certificate(answer: dict[str, Any]) -> None:
    """The certificate as a table."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"{answer['plan']}: {'certified' if answer['passed'] else 'refused'}", title_justify="left")
    for heading in ("", "point", "worst", "allowed", "where"):
        table.add_column(heading, justify="right" if heading in ("worst", "allowed") else "left")
    for finding in answer["findings"]:
        place = [finding["who"]] if finding["who"] else []
        place += [f"interval {finding['interval']}"] if finding["interval"] is not None else []
        value = "not a number" if finding["value"] is None else f"{finding['value']:.3g}"
        allowed = f"{finding['tolerance']:.3g} {finding['unit']}".rstrip()
        table.add_row(
            _mark(finding["passed"]), f"{finding['name']}: {finding['text']}", value, allowed, ", ".join(place)
        )
    Console().print(table)


def replay(answer: dict[str, Any]) -> None:
    """Both modes as planned, and the perturbed trials, as tables."""
    from rich.console import Console

    console = Console()
    title = f"{answer['plan']}: {'executed' if answer['passed'] else 'failed'}"
    table = _narrow(title, ("", "as planned"), ("at goal", "on the way", "slip", "force", "corr.", "ratio", "speed"))
    for row in answer["nominal"]:
        table.add_row(
            _mark(row["passed"]), row["mode"], _errors(row["final"]), _errors(row["largest"]),
            f"{1e3 * row['slip']:.1f} mm", f"{row['force']:.1f} N", _ratio(row["correlation"]), _ratio(row["gain"]),
            f"{row['speed']:.0f}×",
        )  # fmt: skip
    console.print(table)
    if not answer["trials"]:
        return
    table = _narrow("perturbed trials", ("", "mode"), ("at goal", "95 %", "median", "worst", "drops", "slip", "force"))
    for row in answer["trials"]:
        low, high = row["wilson"]
        table.add_row(
            _mark(row["passed"]), row["mode"], f"{row['successes']} of {row['trials']}",
            f"{100 * low:.0f}–{100 * high:.0f} %", _errors(row["median_error"]), _errors(row["worst_error"]),
            str(row["drops"]), f"{1e3 * row['largest_slip']:.1f} mm", f"{row['largest_force']:.1f} N",
        )  # fmt: skip
    console.print(table)
    for row in answer["trials"]:
        for failure in row["failures"]:
            who = f"{failure['who']} " if failure["who"] else ""
            place = f"interval {failure['interval']}, t = {failure['time']:.2f} s"
            print(f"{row['mode']}, trial {failure['trial']}: {place}: {who}{failure['why']}")


def _narrow(title: str, words: tuple[str, ...], figures: tuple[str, ...]) -> "Table":
    """A table without lines, which fits 80 columns."""
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=None, padding=(0, 1, 0, 0))
    for heading in (*words, *figures):
        table.add_column(heading, justify="left" if heading in words else "right", no_wrap=True)
    return table


def _ratio(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _mark(passed: bool) -> str:
    return "[green]✓[/]" if passed else "[bold red]✗[/]"


def _errors(error: list[float | None]) -> str:
    """m and rad in words."""
    shift, turn = error
    return "lost" if shift is None or turn is None else f"{1e3 * shift:.2f} mm {math.degrees(turn):.2f}°"


def grasps(answer: dict[str, Any]) -> None:
    """Each grasp as a table and as what `start` of a scene file says of it."""
    from rich.console import Console

    console = Console()
    for number, grasp in enumerate(answer.get("grasps", ()), 1):
        title = f"grasp {number}: holds with {100 * grasp['friction']:.0f} % of the friction"
        table = _narrow(title, ("agent",), ("touches at, mm", "normal", "presses with"))
        for hold in grasp["holds"]:
            p, n = (
                ", ".join(f"{x:.{d}f}" for x in v) for v, d in (([1e3 * x for x in hold["p_O"]], 1), (hold["n_O"], 2))
            )
            table.add_row(hold["agent"], f"({p})", f"({n})", f"{math.hypot(*hold['force_W']):.2f} N")
        console.print(table)
        print("start:\n  grasp:")
        for hold in grasp["holds"]:
            print(f"    - {{agent: {hold['agent']}, joints: [{', '.join(f'{x:.5f}' for x in hold['q'])}]}}")
        if grasp["off"]:
            print(f"  off: [{', '.join(grasp['off'])}]")
    if "picture" in answer:
        print(f"picture: {answer['picture']}")


def scenes(answer: dict[str, Any]) -> None:
    """Names and descriptions."""
    from rich.console import Console
    from rich.table import Table

    table = Table("scene", "what it asks", box=None, padding=(0, 2, 1, 0))
    for scene in answer["scenes"]:
        table.add_row(scene["name"], scene["description"].strip())
    Console().print(table)


def models(answer: dict[str, Any]) -> None:
    """What a scene's `model` can be: the hands with their fields, the menagerie's models, a file."""
    print("model: {hand: NAME, ...}")
    for name, fields in answer["hands"].items():
        print(f"  {name}: " + ", ".join(f"{field} ({words})" for field, words in fields.items()))
    print("model: {menagerie: NAME}")
    if answer["root"] is None:
        print("  none: MENAGERIE_ROOT is not set (the folder of a copy of MuJoCo Menagerie)")
    for name in answer["menagerie"]:
        print(f"  {name}")
    print("model: {file: PATH}\n  any MJCF or URDF file; regrasp doctor PATH says what will go wrong")


def diagnosis(answer: dict[str, Any]) -> None:
    """The symptoms, one a line, and the bodies that could be tips."""
    for symptom in answer["symptoms"]:
        remedy = f" ({symptom['remedy']})" if symptom["remedy"] else ""
        print(f"{symptom['severity']}: {symptom['where']}: {symptom['what']}{remedy}")
    if answer["tips"]:
        print(f"chains end in: {', '.join(answer['tips'])}")
    counts = {kind: sum(s["severity"] == kind for s in answer["symptoms"]) for kind in ("error", "warning", "note")}
    print(f"{answer['examined']}: " + ", ".join(f"{n} {kind}{'s' * (n != 1)}" for kind, n in counts.items()))


def picture(answer: dict[str, Any]) -> None:
    """File and size of the picture or the clip."""
    if "clip" in answer:
        print(f"{answer['clip']}: {answer['pictures']} pictures")
    else:
        print(f"{answer['picture']}: {answer['width']} × {answer['height']} px")


def figure(answer: dict[str, Any]) -> None:
    """File and panels of the figure."""
    print(f"{answer['figure']}: {', '.join(answer['panels'])}")


def page(answer: dict[str, Any]) -> None:
    """File and size of the page."""
    if "html" in answer:
        print(f"{answer['html']}: {answer['bytes'] / 1e6:.2f} MB")


def commands(answer: dict[str, Any]) -> None:
    """The commands, the exit codes."""
    width = max(map(len, answer["commands"]))
    print("usage: regrasp COMMAND ...\n\nPlans how robot fingers and cooperating arms re-configure an object.\n")
    for name, words in answer["commands"].items():
        print(f"  {name:{width}}  {words}")
    print(f"\nregrasp COMMAND --help tells its options. {JSON}")
    print("Exit codes: 0 done, 1 no plan or certificate refused (with the reason), 2 bad input (one line).")
