"""What will go wrong with a scene or a robot, before anything is planned: each symptom with its remedy."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np

from regrasp.errors import InputError
from regrasp.scene import collisions, fits, menagerie, models
from regrasp.scene.forms import OwnModel
from regrasp.scene.load import load
from regrasp.scene.models import Robot
from regrasp.scene.openings import FILL
from regrasp.scene.reach import nearest
from regrasp.scene.world import World, build

LOOSE = 1.5
"""Volume of the shapes about a mesh over that of its hull from which on they are worth a word."""
ROUGH = 5e-4
"""m that a mesh's surface may be off in creases, where no tip gets; elsewhere it is off far less."""
LONG = 5.0
"""No link of a hand or arm is longer than this, m."""
SHORT = 1e-3
"""No hand or arm is smaller than this, m."""


@dataclass(frozen=True)
class Symptom:
    """What was found: `severity` error (planning will fail), warning (it may, or physics will) or note; where; what; remedy."""

    severity: Literal["error", "warning", "note"]
    where: str
    what: str
    remedy: str = ""

    def __str__(self) -> str:
        line = f"{self.severity}: {self.where}: {self.what}"
        return f"{line} ({self.remedy})" if self.remedy else line


@dataclass(frozen=True)
class Diagnosis:
    """Of a scene or a robot: the symptoms, the worst first, and the bodies that a robot's chains end in: its likely tips."""

    symptoms: tuple[Symptom, ...]
    tips: tuple[str, ...]

    @property
    def healthy(self) -> bool:
        """Whether nothing is an error."""
        return all(symptom.severity != "error" for symptom in self.symptoms)


def examine(name_or_path: str) -> Diagnosis:
    """The diagnosis of a scene (built-in name or file) or of a robot (MJCF, URDF or menagerie name).

    Raises InputError where there is no such file, or where a scene file is not a scene.
    """
    path = Path(name_or_path)
    if name_or_path in menagerie.names() or path.suffix.lower() in (".xml", ".mjcf", ".urdf", ".xacro"):
        file = menagerie.path(name_or_path) if name_or_path in menagerie.names() else path
        if not file.is_file():
            raise InputError("model", f"no file {file}", "a path of an MJCF or URDF file")
        try:
            robot = models.read_file(file, {})
        except InputError as error:
            return _ordered([_refusal(error)])
        return _ordered([*_of_robot(robot)], _ends(robot.spec.compile()))
    scene = load(name_or_path)
    found: list[Symptom] = []
    try:
        if isinstance(scene.model, OwnModel):
            found += _of_robot(models.read(scene.model))
        world = build(scene)
    except InputError as error:
        return _ordered([*found, _refusal(error)])
    said = {symptom.what for symptom in found}
    found += [Symptom("note", "model", repair) for repair in world.repairs if repair not in said]
    return _ordered([*found, *_of_world(world)])


def _ordered(symptoms: list[Symptom], tips: tuple[str, ...] = ()) -> Diagnosis:
    rank = ("error", "warning", "note")
    return Diagnosis(tuple(sorted(symptoms, key=lambda symptom: rank.index(symptom.severity))), tips)


def _refusal(error: InputError) -> Symptom:
    return Symptom("error", error.field, error.reason, error.hint)


def _of_robot(robot: Robot) -> Iterator[Symptom]:
    """Of a robot of one's own by itself."""
    model = robot.spec.compile()
    for repair in robot.repairs:
        yield Symptom("note", "model", repair)
    yield from _of_joints(model)
    yield from _of_sizes(model)
    for equality in robot.spec.equalities:
        if equality.type == mujoco.mjtEq.mjEQ_JOINT and equality.name2 and not np.any(equality.data[2:5]):
            continue  # one joint follows another
        who = " and ".join(repr(end) for end in (equality.name1, equality.name2) if end)
        yield Symptom(
            "warning", who, "bound by an equality constraint: not to be in an agent's chain", "free joints there"
        )
    tied = {name for e in robot.spec.equalities if e.type == mujoco.mjtEq.mjEQ_TENDON for name in (e.name1, e.name2)}
    loose = [tendon.name for tendon in robot.spec.tendons if tendon.name not in tied]
    if loose:
        what = f"{len(loose)} tendons are ignored: the joints that they couple move each by itself in a plan"
        yield Symptom("warning", "model", what, "an equality constraint that says how its joints share a tendon")
    option = model.opt
    weak = [
        word
        for word, bad in (
            ("cone=pyramidal", option.cone == int(mujoco.mjtCone.mjCONE_PYRAMIDAL)),
            (f"impratio={option.impratio:g}", option.impratio < 10),
            (f"noslip_iterations={option.noslip_iterations}", option.noslip_iterations < 10),
        )
        if bad
    ]
    if weak:
        remedy = "regrasp replaces them: cone=elliptic, impratio=10, noslip_iterations=10; so should another simulation of it"
        yield Symptom("note", "model.option", f"with {', '.join(weak)} a grasp creeps", remedy)
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    bare = [model.body(b).name for b in range(1, model.nbody)
            if model.body_jntnum[b] and not solid[model.body_weldid[model.geom_bodyid] == b].any()]  # fmt: skip
    if bare:
        yield Symptom(
            "note", _list("link", bare), "nothing of it collides", "collision geometry, if it can touch anything"
        )


def _of_joints(model: mujoco.MjModel) -> Iterator[Symptom]:
    names = [model.joint(j).name or f"{j}" for j in range(model.njnt)]
    kind = model.jnt_type
    for j in np.flatnonzero(kind == int(mujoco.mjtJoint.mjJNT_FREE)):
        body = model.body(model.jnt_bodyid[j]).name
        yield Symptom("note", f"body {body!r}", "floats: held where the file puts it", "model.pose places it")
    for j in np.flatnonzero(kind == int(mujoco.mjtJoint.mjJNT_BALL)):
        yield Symptom("warning", f"joint {names[j]!r}", "is a ball: no agent can have it", "three hinges")
    single = np.isin(kind, [int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)])
    free = [names[j] for j in np.flatnonzero(single & (model.jnt_limited == 0))]
    if free:
        yield Symptom("warning", _list("joint", free), "has no limits", "a range (URDF: revolute with lower, upper)")
    dof = model.jnt_dofadr
    slack = (model.dof_damping[dof] == 0) & (model.dof_armature[dof] == 0)
    loose = [names[j] for j in np.flatnonzero(single & slack)]
    if loose:
        remedy = "armature of a motor, say 1e-4 kg m² for a finger, or some damping"
        yield Symptom("warning", _list("joint", loose), "has neither damping nor armature: physics may shake", remedy)


def _of_sizes(model: mujoco.MjModel) -> Iterator[Symptom]:
    """Links and robots of impossible size: millimetres taken for metres, or the other way round."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    bodied = model.geom_type != int(mujoco.mjtGeom.mjGEOM_PLANE)
    for g in np.flatnonzero(bodied & (2 * model.geom_aabb[:, 3:].max(axis=1) > LONG)):
        long = 2 * float(model.geom_aabb[g, 3:].max())
        body = model.body(model.geom_bodyid[g]).name
        yield Symptom(
            "error", f"body {body!r}", f"a geom is {long:.3g} m long: millimetres?", "scale: 0.001 of its mesh"
        )
    if bodied.any():
        corners = data.geom_xpos[bodied]
        size = float(np.ptp(corners, axis=0).max() + model.geom_rbound[bodied].max())
        if size < SHORT:
            yield Symptom(
                "error", "model", f"all of it is {1e3 * size:.2g} mm large: written in another unit?", "metres"
            )


def _of_world(world: World) -> Iterator[Symptom]:
    """Of a scene that can be built."""
    scene, model = world.scene, world.model
    data = mujoco.MjData(model)
    data.qpos[:] = world.start
    mujoco.mj_kinematics(model, data)
    yield from _of_rest(world, data)
    yield from _of_object(world)
    for said in world.links.said:
        yield Symptom("note", "model", said)
    for said in world.links.crowded:
        yield Symptom("warning", "model", said, "another home, or primitives for collision geometry")
    for g, shapes in world.links.shapes.items():
        vertices = collisions.vertices(model, g)
        ratio = sum(shape.volume for shape in shapes) / max(fits.volume(vertices), 1e-12)
        if ratio > LOOSE:
            out = 1e3 * fits.excess(shapes, vertices)
            what = (
                f"{' + '.join(shape.kind for shape in shapes)} hold {ratio:.1f} times its volume, {out:.0f} mm outside"
            )
            yield Symptom("note", _called(model, g), what, "primitives for collision geometry would leave more room")
    yield from _of_reach(world)
    weight = float(model.body_mass[world.object_body] * np.linalg.norm(scene.gravity))
    most = sum(agent.max_force * np.hypot(1.0, agent.friction) for agent in world.agents)
    if weight > most and not scene.carriers:
        yield Symptom(
            "error", "agents", f"together they bear {most:.3g} N at most, the object weighs {weight:.3g} N",
            "a larger max_force, more agents, a lighter object or supports",
        )  # fmt: skip


def _of_object(world: World) -> Iterator[Symptom]:
    """How well the grid that contacts roll on describes the object's mesh."""
    matter = world.matter
    if matter.mesh is None:
        return
    off, rounding = 1e3 * matter.error, 1e3 * float(matter.size[3])
    what = f"a grid of {1e3 * matter.resolution:.2g} mm, within {off:.2g} mm of the mesh rounded by {rounding:.2g} mm"
    if matter.ball:
        what += f", hollows narrower than a ball of {1e3 * matter.ball:.2g} mm filled by {1e3 * FILL:.2g} mm at most"
    rough = matter.error > ROUGH
    yield Symptom("warning" if rough else "note", "object", what, "a smaller object.resolution" if rough else "")


def _of_rest(world: World, data: mujoco.MjData) -> Iterator[Symptom]:
    """Bodies that overlap with every agent at rest and the object at its start; `data` after mj_kinematics."""
    model = world.model
    deepest: dict[tuple[str, str], tuple[float, bool]] = {}
    for g, h in world.collision_pairs:
        depth = -mujoco.mj_geomDistance(model, data, int(g), int(h), collisions.REACH, None)
        held = bool({int(g), int(h)} & {int(o) for o in world.object_geoms})
        who = _called(model, int(g)), _called(model, int(h))
        if depth > max(deepest.get(who, (0.0, held))[0], 0.0):
            deepest[who] = depth, held
    for who, (depth, held) in deepest.items():
        what = f"overlap by {1e3 * depth:.2g} mm at rest"
        if held:
            yield Symptom("note", " and ".join(who), what, "an agent that is off needs another home")
        else:
            yield Symptom("error", " and ".join(who), what, "another home, or an <exclude> where they are meant to")


def _of_reach(world: World) -> Iterator[Symptom]:
    scene = world.scene
    for agent in world.agents:
        gaps = [nearest(world, agent, pose.p, pose.wxyz) for pose in (scene.start.pose, scene.goal.pose)]
        where = f"agent {agent.name!r}"
        if min(gaps) > 0.0:
            what = f"its tip comes no nearer than {1e3 * min(gaps):.0f} mm to the object, at start or goal"
            yield Symptom("error", where, what, "another place of the robot (model.pose) or the object")
        elif max(gaps) > 0.0:
            end = "start" if gaps[0] > 0.0 else "goal"
            what = f"its tip does not reach the object at the {end}, {1e3 * max(gaps):.0f} mm short"
            yield Symptom("note", where, what, "others must hold it there")


def _ends(model: mujoco.MjModel) -> tuple[str, ...]:
    """The outermost bodies of a robot's chains that have a colliding geom."""
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    weld = model.body_weldid
    carriers = {int(weld[b]) for b in range(1, model.nbody) if model.body_jntnum[b]}
    inner = {int(weld[model.body_parentid[b]]) for b in carriers}
    ends = []
    for moved in sorted(carriers - inner):
        bodies = [b for b in range(1, model.nbody) if weld[b] == moved and solid[model.geom_bodyid == b].any()]
        ends += [model.body(b).name for b in bodies[-1:]]
    return tuple(ends)


def _called(model: mujoco.MjModel, geom: int) -> str:
    """A geom by its body, which has the name its author gave; by itself where it is the world's."""
    body = int(model.geom_bodyid[geom])
    return f"body {model.body(body).name!r}" if body else f"geom {model.geom(geom).name!r}"


def _list(word: str, names: list[str]) -> str:
    return f"{word} {names[0]!r}" if len(names) == 1 else f"{word}s {', '.join(names)}"
