"""The answers of the command line's commands as text on stdout, for people."""

from typing import Any

JSON = "--json: print one JSON object on stdout instead of text."


def plan(answer: dict[str, Any]) -> None:
    """The plan's counts, and the use of each contact motion."""
    if "plan" not in answer:
        return
    motions = ", ".join(f"{count} {name}" for name, count in answer["motions"].items())
    print(
        f"{answer['plan']}: {answer['intervals']} intervals, {len(answer['agents'])} agents, "
        f"{answer['duration']:.3g} s of motion, energy {answer['energy']:.4g}; "
        f"planned in {answer['seconds']:.2f} s with seed {answer['seed']}\n"
        f"contact motions: {motions}"
    )
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
        mark = "[green]✓[/]" if finding["passed"] else "[bold red]✗[/]"
        table.add_row(mark, f"{finding['name']}: {finding['text']}", value, allowed, ", ".join(place))
    Console().print(table)


def scenes(answer: dict[str, Any]) -> None:
    """Names and descriptions."""
    from rich.console import Console
    from rich.table import Table

    table = Table("scene", "what it asks", box=None, padding=(0, 2, 1, 0))
    for scene in answer["scenes"]:
        table.add_row(scene["name"], scene["description"].strip())
    Console().print(table)


def picture(answer: dict[str, Any]) -> None:
    """File and size of the picture."""
    print(f"{answer['picture']}: {answer['width']} × {answer['height']} px")


def commands(answer: dict[str, Any]) -> None:
    """The commands, the exit codes."""
    width = max(map(len, answer["commands"]))
    print("usage: regrasp COMMAND ...\n\nPlans how robot fingers and cooperating arms re-configure an object.\n")
    for name, words in answer["commands"].items():
        print(f"  {name:{width}}  {words}")
    print(f"\nregrasp COMMAND --help tells its options. {JSON}")
    print("Exit codes: 0 done, 1 no plan or certificate refused (with the reason), 2 bad input (one line).")
