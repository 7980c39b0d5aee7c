"""Plans written down in closed form, without the planner: free-flying spherical tips on a ball, a box on a plane.

Everything is stated in the object's frame as functions of u in [0, 1] and carried into the world by the object's pose.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from regrasp.plan import MOTIONS, Plan
from regrasp.scene import world as worlds
from regrasp.scene.load import validate
from regrasp.scene.world import World

Array = NDArray[np.float64]
BALL, TIP, MASS, FRICTION = 0.03, 0.01, 0.2, 0.7
WEIGHT = MASS * 9.81
M = 9


@dataclass(frozen=True)
class Hold:
    """One agent over one interval: motion of its tip in O, and where it is in contact p_C, n, x (None: no contact)."""

    code: str
    tip: Callable[[float], tuple[Rotation, Array]]
    contact: Callable[[float], tuple[Array, Array, Array]] | None = None
    twist: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    squeeze: float = 1.5
    """Nominal normal force in object weights; a sliding tip has exactly this."""
    slip: Callable[[float], Array] | None = None
    """Unit direction of slip in O."""


@dataclass(frozen=True)
class Rest:
    """One support slot over one interval: contact point in O, normal in W, force in W (weights), mode."""

    name: str
    point: Callable[[float], Array]
    normal: Array
    force: Callable[[float], Array]
    mode: int


@dataclass(frozen=True)
class Interval:
    pose: Callable[[float], tuple[Rotation, Array]]
    holds: Sequence[Hold]
    rests: Sequence[Rest] = field(default=())
    duration: float = 1.0


def free_tips(path: Path, count: int) -> dict[str, object]:
    """A model of `count` spherical tips, each on three slides and three hinges."""
    tips = "".join(
        f'<body name="tip{i}">'
        + "".join(f'<joint name="{kind}{axis}{i}" type="{kind}" axis="{unit}"/>'
                  for kind in ("slide", "hinge")
                  for axis, unit in (("x", "1 0 0"), ("y", "0 1 0"), ("z", "0 0 1")))
        + f'<geom name="tip{i}" size="{TIP}" mass="0.05"/></body>'
        for i in range(count)
    )  # fmt: skip
    path.write_text(f"<mujoco><worldbody>{tips}</worldbody></mujoco>")
    return {"file": str(path)}


def scene(model: dict[str, object], count: int, **changes: object) -> dict[str, object]:
    """The scene of a ball at the origin, which it need not leave."""
    base = {
        "name": "handmade",
        "model": model,
        "object": {"shape": "sphere", "size": [BALL], "mass": MASS},
        "agents": [{"name": f"tip{i}", "tip": f"tip{i}"} for i in range(count)],
        "friction": FRICTION,
        "max_force": 20.0,
        "start": {"pose": {"position": [0, 0, 0]}},
        "goal": {"pose": {"position": [0, 0, 0]}},
    }
    return base | changes


def build(data: dict[str, object]) -> World:
    return worlds.build(validate(data))


def still(u: float) -> tuple[Rotation, Array]:
    return Rotation.identity(), np.zeros(3)


def arc(u: float) -> tuple[Rotation, Array]:
    """A quarter turn on a circle in the x-z plane, turning about an oblique axis meanwhile."""
    a = 0.5 * math.pi * u
    return Rotation.from_rotvec(0.6 * u * np.array([0.6, 0.0, 0.8])), 0.02 * np.array(
        [math.sin(a), 0.0, 1 - math.cos(a)]
    )


def line(u: float) -> tuple[Rotation, Array]:
    return Rotation.identity(), u * np.array([0.03, 0.01, -0.02])


def after(first: Callable[[float], tuple[Rotation, Array]], second: Callable[[float], tuple[Rotation, Array]]):
    """The motion `second` made from where `first` ends."""

    def pose(u: float) -> tuple[Rotation, Array]:
        R, p = second(u)
        R0, p0 = first(1.0)
        return R * R0, p0 + p

    return pose


def around(count: int, offset: float = 0.0) -> list[Array]:
    """Outward normals evenly on the ball's equator."""
    angles = offset + 2 * math.pi * np.arange(count) / count
    return [np.array([math.cos(a), math.sin(a), 0.0]) for a in angles]


def across(n: Array) -> Array:
    x = np.cross([0.0, 0.0, 1.0] if abs(n[2]) < 0.9 else [1.0, 0.0, 0.0], n)
    return x / np.linalg.norm(x)


def stay(n: Array, turned: Rotation | None = None, squeeze: float = 1.5) -> Hold:
    """The tip rests at the ball's normal n."""
    R = turned or Rotation.identity()
    return Hold("stay", lambda u: (R, (BALL + TIP) * n), lambda u: (BALL * n, n, across(n)), squeeze=squeeze)


def roll(n: Array, code: str, angle: float, squeeze: float = 1.0) -> Hold:
    """The tip rolls by `angle` (rad, relative) about ±x or ±y: its centre goes round a great circle of the ball.

    Montana's equation with curvatures 1/r and 1/ρ: the contact moves by angle / (1/r + 1/ρ), that is by the angle
    angle ρ / (r + ρ) at the ball's centre.
    """
    x = across(n)
    axis = x if code[-1] == "x" else np.cross(n, x)
    signed = angle if code[-2] == "+" else -angle

    def turned(u: float) -> tuple[Array, Array]:
        R = Rotation.from_rotvec(axis * signed * u * TIP / (BALL + TIP))
        return R.apply(n), R.apply(x)

    def contact(u: float) -> tuple[Array, Array, Array]:
        normal, along = turned(u)
        return BALL * normal, normal, along

    twist = (signed, 0.0, 0.0, 0.0) if code[-1] == "x" else (0.0, signed, 0.0, 0.0)
    return Hold(
        code,
        lambda u: (Rotation.from_rotvec(axis * signed * u), (BALL + TIP) * turned(u)[0]),
        contact,
        twist,
        squeeze,
    )


def slide(n: Array, code: str, way: float, squeeze: float = 0.3) -> Hold:
    """The tip slides by `way` (m, relative) along ±x or ±y without turning relative to the ball."""
    x = across(n)
    sign = 1.0 if code[-2] == "+" else -1.0
    v = sign * (x if code[-1] == "x" else np.cross(n, x))
    axis = np.cross(n, v)

    def turned(u: float) -> Rotation:
        return Rotation.from_rotvec(axis * way * u / (BALL + TIP))

    def contact(u: float) -> tuple[Array, Array, Array]:
        R = turned(u)
        return BALL * R.apply(n), R.apply(n), R.apply(x)

    twist = (0.0, 0.0, sign * way, 0.0) if code[-1] == "x" else (0.0, 0.0, 0.0, sign * way)
    return Hold(
        code,
        lambda u: (Rotation.identity(), (BALL + TIP) * turned(u).apply(n)),
        contact,
        twist,
        squeeze,
        lambda u: turned(u).apply(v),
    )


def relocate(start: Array, end: Array, height: float = 0.02) -> Hold:
    """The tip leaves the ball at the normal `start`, passes over it and lands at the normal `end`."""
    axis = np.cross(start, end)
    angle = math.atan2(float(np.linalg.norm(axis)), float(start @ end))
    axis = axis / np.linalg.norm(axis)

    def tip(u: float) -> tuple[Rotation, Array]:
        s = u * u * (3 - 2 * u)
        n = Rotation.from_rotvec(axis * angle * s).apply(start)
        return Rotation.identity(), (BALL + TIP + height * 4 * u * (1 - u)) * n

    return Hold("relocate", tip)


def free_joints(R_WT: Rotation, p_WT: Array) -> Array:
    """Joints of a free-flying tip."""
    return np.concatenate([p_WT, R_WT.as_euler("XYZ")])


def planar_joints(base: Array, links: tuple[float, float, float], R_WT: Rotation, p_WT: Array) -> Array:
    """Joints of a planar finger, elbow up, whose last link makes the angle of R_WT about −y with the x axis."""
    angle = -float(R_WT.as_rotvec()[1])
    wrist = p_WT[[0, 2]] - links[2] * np.array([math.cos(angle), math.sin(angle)]) - base
    reach = float(wrist @ wrist)
    bend = -math.acos((reach - links[0] ** 2 - links[1] ** 2) / (2 * links[0] * links[1]))
    aim = math.atan2(wrist[1], wrist[0])
    first = aim - math.atan2(links[1] * math.sin(bend), links[0] + links[1] * math.cos(bend))
    return np.array([first, bend, angle - first - bend])


def compose(
    world: World, intervals: Sequence[Interval], inverse: Callable[[Rotation, Array], Array] = free_joints
) -> Plan:
    """The plan of these intervals; forces of sticking contacts are balanced around their nominal squeeze."""
    N, k = len(intervals), len(world.agents)
    names = tuple(rest.name for rest in intervals[0].rests)
    P = len(names)
    shape = (N, M)
    a = {
        "time": np.zeros(shape), "object_position": np.zeros((*shape, 3)), "object_quaternion": np.zeros((*shape, 4)),
        "joints": np.zeros((*shape, sum(len(agent.qpos) for agent in world.agents))),
        "V": np.zeros((N, k), np.int8), "twist": np.zeros((N, k, 4)),
        "support_mode": np.zeros((N, P), np.int8), "segment": np.zeros(N, np.int64),
        "energy": np.array([3.0, 1.0]), "energy_segment": np.zeros(2, np.int64),
    }  # fmt: skip
    a |= {name: np.full((*shape, k, 3), np.nan) for name in ("p_OC_O", "n_O", "x_O")}
    a |= {"force_W": np.zeros((*shape, k, 3))}
    a |= {name: np.zeros((*shape, P, 3)) for name in ("support_p_O", "support_n_W", "support_force_W")}
    begin = 0.0
    for j, interval in enumerate(intervals):
        a["V"][j] = [MOTIONS.index(hold.code) for hold in interval.holds]
        a["twist"][j] = [hold.twist for hold in interval.holds]
        a["support_mode"][j] = [rest.mode for rest in interval.rests]
        for m, u in enumerate(np.linspace(0.0, 1.0, M)):
            a["time"][j, m] = begin + u * interval.duration
            R, p = interval.pose(float(u))
            a["object_position"][j, m], a["object_quaternion"][j, m] = p, R.as_quat(scalar_first=True)
            joints = []
            for i, hold in enumerate(interval.holds):
                R_OT, p_OT = hold.tip(float(u))
                joints.append(inverse(R * R_OT, p + R.apply(p_OT)))
                if hold.contact is not None:
                    a["p_OC_O"][j, m, i], a["n_O"][j, m, i], a["x_O"][j, m, i] = hold.contact(float(u))
            a["joints"][j, m] = np.concatenate(joints)
            for i, rest in enumerate(interval.rests):
                a["support_p_O"][j, m, i], a["support_n_W"][j, m, i] = rest.point(float(u)), rest.normal
            a["force_W"][j, m], a["support_force_W"][j, m] = _forces(interval, float(u), R)
        begin += interval.duration
    ends = [(0, 0), (N - 1, -1)]
    a["route"] = np.array([[*a["object_position"][e], *a["object_quaternion"][e]] for e in ends])
    return Plan(
        **a,
        support_names=names,
        agent_names=tuple(agent.name for agent in world.agents),
        joint_names=tuple(world.model.joint(int(i)).name for agent in world.agents for i in agent.joints),
        scene=world.scene.model_dump(mode="json"), xml=world.xml, assets=world.assets,
        seed=0, settings={}, versions={}, feasible=True,
    )  # fmt: skip


def _forces(interval: Interval, u: float, R: Rotation) -> tuple[Array, Array]:
    """Forces of agents and supports in W: nominal ones; sticking tips' are corrected least to balance exactly."""
    points, nominal, free = [], [], []
    for hold in interval.holds:
        if hold.contact is None:
            points.append(np.zeros(3))
            nominal.append(np.zeros(3))
            free.append(False)
            continue
        p, n, _ = hold.contact(u)
        inward = -n if hold.slip is None else -n + FRICTION * hold.slip(u)
        points.append(R.apply(p))
        nominal.append(R.apply(inward) * hold.squeeze * WEIGHT)
        free.append(hold.slip is None)
    for rest in interval.rests:
        points.append(R.apply(rest.point(u)))
        nominal.append(rest.force(u) * WEIGHT)
        free.append(False)
    forces, arms = np.array(nominal), np.array(points)
    wrench = np.concatenate([forces.sum(0) - np.array([0, 0, WEIGHT]), np.cross(arms, forces).sum(0)])
    at = np.flatnonzero(free)
    G = np.concatenate([np.concatenate([np.eye(3), np.cross(arms[i], np.eye(3)).T]) for i in at], axis=1)
    scale = np.array([1, 1, 1, 1 / BALL, 1 / BALL, 1 / BALL])
    correction = np.linalg.lstsq(scale[:, None] * G, -scale * wrench, rcond=1e-10)[0]
    forces[at] += correction.reshape(-1, 3)
    return forces[: len(interval.holds)], forces[len(interval.holds) :]
