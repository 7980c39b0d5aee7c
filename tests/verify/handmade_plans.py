"""The handmade plans by name: held, carried, rolled, slid, relocated, pushed on a table, a planar finger, a rim."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from handmade import (
    BALL,
    TIP,
    Array,
    Hold,
    Interval,
    Rest,
    across,
    after,
    arc,
    around,
    build,
    compose,
    free_tips,
    line,
    planar_joints,
    relocate,
    roll,
    scene,
    slide,
    stay,
    still,
)  # fmt: skip
from scipy.spatial.transform import Rotation

from regrasp.plan import SLIDE, STICK, Plan
from regrasp.scene.world import World

TOP = np.array([0.0, 0.0, 1.0])


def _pose(pose) -> dict[str, object]:
    R, p = pose(1.0)
    return {"pose": {"position": p.tolist(), "quaternion": R.as_quat(scalar_first=True).tolist()}}


def _ball(model: dict[str, object], intervals: list[Interval]) -> tuple[Plan, World]:
    data = scene(model, len(intervals[0].holds), goal=_pose(intervals[-1].pose))
    world = build(data)
    return compose(world, intervals), world


def _hold(directory: Path) -> tuple[Plan, World]:
    three = [stay(n, squeeze=2.0) for n in around(3)]
    return _ball(free_tips(directory / "hold.xml", 3), [Interval(still, three)] * 2)


def _carry(directory: Path) -> tuple[Plan, World]:
    three = [stay(n, squeeze=2.0) for n in around(3)]
    return _ball(free_tips(directory / "carry.xml", 3), [Interval(arc, three), Interval(after(arc, line), three)])


def _roll(directory: Path) -> tuple[Plan, World]:
    three = [stay(n, squeeze=2.0) for n in around(3)]
    intervals, n = [], TOP
    pose = arc
    for code in ("roll+x", "roll-y"):
        hold = roll(n, code, 0.5)
        intervals.append(Interval(pose, [*three, _turned(hold, intervals[-1].holds[3] if intervals else None)]))
        n = hold.contact(1.0)[1]
        pose = after(arc, line)
    return _ball(free_tips(directory / "roll.xml", 4), intervals)


def _turned(hold: Hold, before: Hold | None) -> Hold:
    """The same motion begun with the tip turned as `before` left it."""
    if before is None:
        return hold
    R0 = before.tip(1.0)[0]
    return Hold(
        hold.code, lambda u: (hold.tip(u)[0] * R0, hold.tip(u)[1]), hold.contact, hold.twist, hold.squeeze, hold.slip
    )


def _slide(directory: Path) -> tuple[Plan, World]:
    three = [stay(n, squeeze=2.0) for n in around(3)]
    first = slide(TOP, "slide+x", 0.006)
    second = slide(first.contact(1.0)[1], "slide-y", 0.005)
    return _ball(
        free_tips(directory / "slide.xml", 4),
        [Interval(line, [*three, first]), Interval(after(line, arc), [*three, second])],
    )


def _relocate(directory: Path) -> tuple[Plan, World]:
    three = [stay(n, squeeze=2.0) for n in around(3)]
    start, end = TOP, np.array([0.5, 0.5, np.sqrt(0.5)])
    tips = [stay(start, squeeze=1.0), relocate(start, end), stay(end, squeeze=1.0)]
    poses = [still, arc, after(arc, line)]
    intervals = [Interval(pose, [*three, tip]) for pose, tip in zip(poses, tips, strict=True)]
    return _ball(free_tips(directory / "relocate.xml", 4), intervals)


def _push(directory: Path) -> tuple[Plan, World]:
    """A box slides on the plane, pushed by one tip; the support's share is worked out by hand."""
    half, mu = 0.03, 0.3
    # Moments about the centre: the push at its height, friction half below; the front carries more than the back.
    lean = mu * half / (2 * 0.02)
    rests = [
        Rest(
            "table",
            lambda u, x=x: np.array([x, 0.0, -half]),
            TOP,
            lambda u, share=share: np.array([-mu, 0.0, 1.0]) * share,
            SLIDE,
        )
        for x, share in ((0.02, 0.5 + lean), (-0.02, 0.5 - lean))
    ]
    n = np.array([-1.0, 0.0, 0.0])
    push = Hold(
        "stay",
        lambda u: (still(0)[0], (half + TIP) * n),
        lambda u: (half * n, n, np.array([0.0, 1.0, 0.0])),
        squeeze=mu,
    )

    def pose(u):
        return still(u)[0], np.array([0.05 * u, 0.0, half])

    data = scene(
        free_tips(directory / "push.xml", 1), 1,
        object={"shape": "box", "size": [half] * 3, "rounding": 0.003, "mass": 0.2},
        environment=[{"name": "table", "shape": "plane", "friction": mu}],
        supports=["table"],
        start={"pose": {"position": [0, 0, half]}},
        goal=_pose(pose),
    )  # fmt: skip
    world = build(data)
    return compose(world, [Interval(pose, [push], rests)]), world


def _rim(directory: Path) -> tuple[Plan, World]:
    """Four tips hold a rounded cylinder by its rims, and carry it along a line."""
    size, rounding = (0.04, 0.02), 0.004
    holds = []
    for azimuth, height in ((0.3, -0.5), (2.4, -0.55), (4.5, -0.45), (1.4, 0.5)):
        n = np.array([np.cos(azimuth) * np.cos(height), np.sin(azimuth) * np.cos(height), np.sin(height)])
        ring = (size[0] - rounding) * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        p = ring + np.copysign(size[1] - rounding, height) * TOP + rounding * n
        holds.append(Hold("stay", lambda u, p=p, n=n: (Rotation.identity(), p + TIP * n),
                          lambda u, p=p, n=n: (p, n, across(n)), squeeze=2.0))  # fmt: skip
    solid = {"shape": "cylinder", "size": list(size), "rounding": rounding, "mass": 0.2}
    world = build(scene(free_tips(directory / "rim.xml", 4), 4, object=solid, goal=_pose(line)))
    return compose(world, [Interval(line, holds)]), world


def _finger(directory: Path) -> tuple[Plan, World]:
    """A planar finger of three joints rolls on top of a ball that lies on a table; both forces lie on one line."""
    base, tilt = np.array([-0.12, 0.10]), np.pi / 3
    hand = {"hand": "planar", "bases": [{"position": base.tolist(), "angle": 0.0}], "tip_radius": TIP}
    data = scene(
        hand, 1,
        agents=[],
        environment=[{"name": "table", "shape": "plane"}],
        supports=["table"],
        start={"pose": {"position": [0, 0, BALL]}},
        goal={"pose": {"position": [0, 0, BALL]}},
    )  # fmt: skip
    world = build(data)
    intervals = []
    for hold in (roll(TOP, "roll-x", 0.4), stay(TOP)):
        if intervals:  # it stays where and as the roll has left it
            R, p = intervals[0].holds[0].tip(1.0)
            contact = intervals[0].holds[0].contact(1.0)
            hold = Hold("stay", lambda u, R=R, p=p: (R, p), lambda u, c=contact: c)
        else:
            hold = _turned(hold, Hold("", lambda u: (Rotation.from_rotvec([0.0, tilt, 0.0]), TOP)))

        def carried(u: float, hold: Hold = hold) -> Array:
            through = -BALL * TOP - hold.contact(u)[0]
            return TOP - through / np.linalg.norm(through)

        rest = Rest("table", lambda u: -BALL * TOP, TOP, carried, STICK)
        intervals.append(Interval(lambda u: (still(u)[0], BALL * TOP), [hold], [rest]))
    return compose(world, intervals, lambda R, p: planar_joints(base, (0.09, 0.07, 0.05), R, p)), world


MAKERS: Mapping[str, Callable[[Path], tuple[Plan, World]]] = {
    "hold": _hold, "carry": _carry, "roll": _roll, "slide": _slide, "relocate": _relocate, "push": _push,
    "finger": _finger,
    "rim": _rim,
}  # fmt: skip
