"""Viewing a plan, or the search for one, in a browser."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

from regrasp.commands.line import DONE, REFUSED, Answer, importing, parse, say, writable
from regrasp.errors import InputError

if TYPE_CHECKING:
    from regrasp.view.server import Server


def view(arguments: list[str]) -> Answer:
    with importing():
        import tyro

    def request(
        plan: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="PLAN|SCENE")],
        html: Annotated[Optional[Path], tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None,  # noqa: UP045
        replay: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
        live: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
        seed: int = 0,
        host: str = "127.0.0.1",
        port: Annotated[
            Optional[int],  # noqa: UP045
            tyro.conf.arg(metavar="N", help_behavior_hint="(default: 8080, or a free one)"),
        ] = None,
        no_browser: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    ) -> dict[str, Any]:
        """Read the command line.

        Args:
            plan: Plan file, as `regrasp plan` writes it; with --live a scene (built-in name or path).
            html: Write the page to a file that needs nothing else, instead of opening it.
            replay: Show what happens in physics, with object feedback, beside what is planned.
            live: Plan the scene, and show the search as it goes.
            seed: Seed of that search.
            host: Address to listen on; other than this machine's own, others reach the page too.
            port: Port to listen on; 0: any free one.
            no_browser: Only print the page's address.
        """
        return {"live": live, "name": plan, "html": html, "replay": replay, "seed": seed, "host": host, "port": port,
                "quiet": no_browser}  # fmt: skip

    asked = parse(request, "view", arguments)
    if asked["live"]:
        for flag in ("html", "replay"):
            if asked[flag]:
                raise InputError(f"--{flag}", "does not go with --live", "view the plan when it is there")
        return _search(asked["name"], asked["seed"], asked["host"], asked["port"], asked["quiet"])
    return _plan(**{key: value for key, value in asked.items() if key not in ("live", "seed")})


def _plan(name: str, html: Path | None, replay: bool, host: str, port: int | None, quiet: bool) -> Answer:
    """The page of a plan, served until it is interrupted, or written."""
    with importing():
        from regrasp.plan import load
        from regrasp.view.story import executed, judged, pack, tell

    if html is not None:
        writable(html, "--html")
    plan = load(name)
    story = tell(plan)
    if replay:
        from regrasp.verify.replay import Bench, control_of

        story = executed(story, plan, Bench(plan, control_of(plan)).nominal("feedback").run)
    if html is not None:
        from regrasp.verify.check import check
        from regrasp.view.page import page

        text = page(pack(judged(story, check(plan))))
        html.write_text(text, "utf-8")
        return DONE, {"plan": name, "html": str(html), "bytes": len(text.encode())}
    from regrasp.view.server import Server

    with Server(pack(story), host, port) as server:
        _open(server, host, quiet)
        from regrasp.verify.check import check

        server.news("certificate", {"certificate": check(plan).to_dict()})
        _wait()
    return DONE, {"plan": name, "url": server.url}


def _search(name: str, seed: int, host: str, port: int | None, quiet: bool) -> Answer:
    """The page of a search, and of the plan that it finds."""
    with importing():
        from regrasp.scene.load import load
        from regrasp.scene.world import build
        from regrasp.view.search import Search, drafted
        from regrasp.view.server import Server
        from regrasp.view.sketch import rest
        from regrasp.view.story import pack, tell

    scene = load(name)
    world = build(scene)
    with Server(pack(drafted(rest(world))), host, port) as server:
        _open(server, host, quiet)
        with importing():
            from regrasp.planner.method import plan_scene
            from regrasp.planner.task import Settings
            from regrasp.settings import read
            from regrasp.verify.check import check
        report = Search(world, server.news, lambda story: server.story(pack(story)))
        outcome = plan_scene(scene, seed, read(Settings, scene.planner), report)
        report.end("" if outcome.failure is None else str(outcome.failure))
        if outcome.plan is not None:
            server.story(pack(tell(outcome.plan)))
            server.news("certificate", {"certificate": check(outcome.plan).to_dict()})
        if outcome.failure is not None:
            say(f"{scene.name}: no plan: {outcome.failure}")
        _wait()
    return (DONE if outcome.failure is None else REFUSED), {"scene": scene.name, "url": server.url}


def _open(server: "Server", host: str, quiet: bool) -> None:
    """Say where the page is, and have a browser show it."""
    from regrasp.view.server import local

    if not local(host):
        say(f"--host: {host} lets everyone who reaches this machine see the page")
    say(f"{server.url}  (Ctrl-C ends it)")
    if not quiet:
        import webbrowser

        webbrowser.open(server.url)


def _wait() -> None:
    """Until Ctrl-C, which is the way to end it."""
    try:
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        pass
