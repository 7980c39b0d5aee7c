"""The world of a scene: the MuJoCo model, and who in it is agent, object, obstacle and support."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.errors import InputError
from regrasp.scene import collisions, fixtures, hands, mjcf, robots, tips
from regrasp.scene.couplings import Coupling, coupling
from regrasp.scene.forms import OwnModel
from regrasp.scene.grids import Grid
from regrasp.scene.links import Links, links
from regrasp.scene.load import validate
from regrasp.scene.matter import Matter, add_to, assets_of, grid_of, matter_of
from regrasp.scene.schema import Scene
from regrasp.scene.strength import normal_force

Array = NDArray[np.float64]
Ids = NDArray[np.int64]

COUPLED = 1e-6
"""By so much, rad or m, a value given to a joint may miss what the joint that it follows asks for."""
MAX_FORCE = 10.0
"""Largest normal force of a tip where neither scene nor model says one, N."""


@dataclass(frozen=True)
class Limb:
    """An open chain of hinges and slides.

    joints: ids, base to tip; qpos, dofs: addresses of their values and velocities; geoms: its colliding geoms; lower, upper:
    joint range, ±inf where unlimited; speed: rad/s or m/s; home: joint values at rest; coupling: which joints follow others.
    Arrays are (n,), n the number of joints.
    """

    name: str
    joints: Ids
    qpos: Ids
    dofs: Ids
    geoms: Ids
    lower: Array
    upper: Array
    speed: Array
    home: Array
    coupling: Coupling


@dataclass(frozen=True)
class Agent(Limb):
    """One finger or arm: a limb that ends in a tip, whose geoms are among its own.

    arm: which of the world's arms carries it, −1 for none; what moves this is not among its joints, bodies and geoms.
    tip_geom: the geom that has the tip's frame; tip_geoms: all that the tip is made of, that one first; tip_kind,
    tip_size (4,): its surface, see `solids.kind`. bodies: those it moves; max_force: largest normal force, N; friction:
    coefficient between tip and object.
    """

    tip_geom: int
    tip_geoms: Ids
    tip_kind: int
    tip_size: Array
    tip_body: int
    bodies: Ids
    max_force: float
    friction: float
    arm: int

    @property
    def freedom(self) -> int:
        """How many of its joints follow no other."""
        return int(np.count_nonzero(self.coupling.free))


@dataclass(frozen=True)
class Arm(Limb):
    """An arm that carries a hand: the hinges and slides that several agents share, which are its fingers.

    name: of the body that the last of its joints moves; body: its id, the frame that its fingers stand in; geoms: without the
    fingers'.
    """

    body: int


@dataclass(frozen=True)
class World:
    """A scene and its compiled model. All ids and addresses are those of `model`.

    xml, assets: the model as text with the files it needs, so that it outlives its sources. object_qpos: address of the
    object's position (3) and quaternion (4). object_kind, object_size: the surface code, see `solids.kind` and
    `matter.MESH`; matter: all that the object is made of. static_geoms: colliding geoms that cannot move, supports included;
    fixture_geoms: those of the environment;
    support_names, support_geoms, support_friction: in the order of `scene.carriers`, each convex part of one of its own.
    collision_pairs: geom ids (n, 2) that must never touch.
    """

    scene: Scene
    model: mujoco.MjModel
    xml: str
    assets: Mapping[str, bytes]
    object_body: int
    object_qpos: int
    object_geoms: Ids
    object_kind: int
    object_size: Array
    matter: Matter
    agents: tuple[Agent, ...]
    arms: tuple[Arm, ...]
    static_geoms: Ids
    fixture_geoms: Ids
    support_names: tuple[str, ...]
    support_geoms: Ids
    support_friction: Array
    collision_pairs: Ids

    @cached_property
    def object_grid(self) -> Grid | None:
        """The signed distance to the object's surface, where no closed form gives it."""
        return grid_of(self.scene.object, self.assets)

    @property
    def limbs(self) -> tuple[Limb, ...]:
        """All that has joints, in the order of a plan's joints: the agents, then the arms that carry them."""
        return (*self.agents, *self.arms)

    @cached_property
    def joints(self) -> Ids:
        """All limbs' joints, limb after limb, (nq,)."""
        return np.concatenate([limb.joints for limb in self.limbs])

    @cached_property
    def joint_qpos(self) -> Ids:
        """Addresses of all limbs' joint values, limb after limb, (nq,)."""
        return np.concatenate([limb.qpos for limb in self.limbs])

    @cached_property
    def joint_dofs(self) -> Ids:
        """Addresses of all limbs' joint velocities, limb after limb, (nq,)."""
        return np.concatenate([limb.dofs for limb in self.limbs])

    @cached_property
    def coupling(self) -> Coupling:
        """Which of all limbs' joints (nq,) follow others."""
        return coupling(self.model, self.joints)

    @cached_property
    def repairs(self) -> tuple[str, ...]:
        """What was put right in a robot of one's own and in the object's mesh, each in a sentence."""
        mesh = self.matter.mesh
        said = mesh.remarks if mesh is not None else ()
        return (*robots.repairs(self.model), *(f"the object's mesh: {remark}" for remark in said))

    @cached_property
    def links(self) -> Links:
        """The shapes that planning takes for links that are meshes."""
        convex = np.concatenate([self.object_geoms, self.fixture_geoms])
        return links(self.model, self.start, self.collision_pairs, convex)

    @cached_property
    def start(self) -> Array:
        """qpos at the start pose of the object with every agent at home, (nq,)."""
        qpos = self.model.qpos0.copy()
        pose = self.scene.start.pose
        qpos[self.object_qpos : self.object_qpos + 7] = [*pose.p, *pose.wxyz]
        for limb in self.limbs:
            qpos[limb.qpos] = limb.home
        return qpos


def build(scene: Scene) -> World:
    """The world of a scene. Raises InputError where the scene asks for what its model does not have."""
    spec = mujoco.MjSpec()
    spec.modelname = scene.name
    spec.compiler.degree = False
    spec.option.gravity = scene.gravity
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # With these a grip of a few newtons holds without creeping: elliptic cones, friction much stiffer than the normal
    # direction, and a last pass that removes the remaining slip.
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10
    spec.option.noslip_iterations = 10
    hands.attach(spec, scene)
    described = {
        **assets_of(scene.object, tips.sharpest(spec, [finger.tip for finger in hands.fingers(scene)])),
        **fixtures.assets_of(scene.environment),
    }
    for body in scene.environment:
        fixtures.add(spec, body, described)
    start = scene.start.pose
    thing = spec.worldbody.add_body(name="object", pos=start.p, quat=start.wxyz)
    thing.add_freejoint(name="object")
    add_to(spec, thing, scene.object, matter_of(scene.object, described))
    # The coefficient of a contact is that of the geom with the higher priority: tips and supports decide, as in a plan.
    names = [geom.name for geom in spec.geoms]
    for finger, friction in zip(hands.fingers(scene), _frictions(scene), strict=True):
        for piece in tips.names(finger.tip, names.__contains__):
            _set_friction(spec.geom(piece), friction)
    for carrier, friction in zip(scene.carriers, _support_friction(scene), strict=True):
        for name in fixtures.parts(carrier, names):
            _set_friction(spec.geom(name), friction)
    try:
        xml = mjcf.text(spec)
    except ValueError as error:
        raise InputError("model", f"MuJoCo cannot compile it: {' '.join(str(error).split())}") from None
    return _world(scene, xml, {**spec.assets, **described})


def from_plan(scene: Mapping[str, Any], xml: str, assets: Mapping[str, bytes]) -> World:
    """The world stored in a plan: the same model and names, without any source file."""
    return _world(validate(dict(scene)), xml, assets)


def _set_friction(geom: mujoco.MjsGeom, friction: float) -> None:
    geom.friction = [friction, *geom.friction[1:]]
    geom.priority = 1


def _frictions(scene: Scene) -> list[float]:
    given = {agent.name: agent.friction for agent in scene.agents}
    return [given.get(name) or scene.friction for name in scene.agent_names]


def _support_friction(scene: Scene) -> list[float]:
    given = {body.name: body.friction for body in scene.environment}
    return [given.get(name) or scene.friction for name in scene.carriers]


def _world(scene: Scene, xml: str, assets: Mapping[str, bytes]) -> World:
    """The world of a model given as text. It is always compiled from the text, so a stored world is the same one."""
    model = mujoco.MjModel.from_xml_string(xml, dict(assets))
    frictions = _frictions(scene)
    fingers = hands.fingers(scene)
    shared = _shared(scene, model, fingers)
    arms = tuple(_arm(model, list(joints)) for joints in shared)
    carriers = [next((c for c, fs in enumerate(shared.values()) if i in fs), -1) for i in range(len(fingers))]
    agents = tuple(_agent(scene, model, i, finger, frictions[i], carriers[i], arms) for i, finger in enumerate(fingers))
    colliding = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    static = (model.body_weldid[model.geom_bodyid] == 0) & colliding
    object_body = model.body("object").id
    object_geoms = np.flatnonzero(model.geom_bodyid == object_body)
    names = [model.geom(g).name for g in range(model.ngeom)]
    carried = [(part, mu) for name, mu in zip(scene.carriers, _support_friction(scene), strict=True)
               for part in fixtures.parts(name, names)]  # fmt: skip
    supports = np.array([model.geom(name).id for name, _ in carried], dtype=np.int64)
    touching = np.concatenate([agent.tip_geoms for agent in agents])
    matter = matter_of(scene.object, assets)
    return World(
        scene=scene,
        model=model,
        xml=xml,
        assets=assets,
        object_body=object_body,
        object_qpos=int(model.joint("object").qposadr[0]),
        object_geoms=object_geoms,
        object_kind=matter.kind,
        object_size=matter.size,
        matter=matter,
        agents=agents,
        arms=arms,
        static_geoms=np.flatnonzero(static),
        fixture_geoms=np.array(
            [model.geom(part).id for body in scene.environment for part in fixtures.parts(body.name, names)], np.int64
        ),
        support_names=tuple(name for name, _ in carried),
        support_geoms=supports,
        support_friction=np.array([mu for _, mu in carried]),
        collision_pairs=collisions.pairs(model, touching, object_geoms, supports),
    )


def _shared(scene: Scene, model: mujoco.MjModel, fingers: tuple[hands.Finger, ...]) -> dict[tuple[int, ...], list[int]]:
    """Joints that several agents share → these agents. Raises InputError where some of them share more than the others."""
    exists = [model.geom(g).name for g in range(model.ngeom)].__contains__
    chains = [_joints(model, int(model.geom(tips.names(finger.tip, exists)[0]).bodyid[0])) for finger in fingers]
    users = {j: [i for i, chain in enumerate(chains) if j in chain] for chain in chains for j in chain}
    arms: dict[tuple[int, ...], list[int]] = {}
    for i, chain in enumerate(chains):
        common = tuple(j for j in chain if len(users[j]) > 1)
        if any(users[j] != users[common[0]] for j in common):
            who = model.joint(next(j for j in common if users[j] != users[common[0]])).name
            raise InputError(
                f"agents.{i}.tip", f"joint {who!r} moves some of an arm's fingers only, but more than one of them",
                "a hand whose fingers share the joints of its arm and no others",
            )  # fmt: skip
        if common:
            arms[common] = users[common[0]]
    return arms


def _joints(model: mujoco.MjModel, body: int) -> list[int]:
    """The joints between the world and a body, the world's first."""
    chain = [body]
    while model.body_parentid[chain[-1]]:
        chain.append(int(model.body_parentid[chain[-1]]))
    return [int(model.body_jntadr[b]) + k for b in reversed(chain) for k in range(model.body_jntnum[b])]


def _range(model: mujoco.MjModel, joints: Ids) -> tuple[Array, Array]:
    """lower, upper (n,) of joints, ±inf where unlimited."""
    limited = model.jnt_limited[joints] != 0
    lower, upper = model.jnt_range[joints].T
    return np.where(limited, lower, -np.inf), np.where(limited, upper, np.inf)


def _arm(model: mujoco.MjModel, shared: list[int]) -> Arm:
    joints = np.array(shared, dtype=np.int64)
    lower, upper = _range(model, joints)
    moved = np.unique(model.body_weldid[model.jnt_bodyid[joints]])
    colliding = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    body, coupled = int(model.jnt_bodyid[joints[-1]]), coupling(model, joints)
    return Arm(
        name=model.body(body).name,
        body=body,
        joints=joints,
        qpos=model.jnt_qposadr[joints].astype(np.int64),
        dofs=model.jnt_dofadr[joints].astype(np.int64),
        geoms=np.flatnonzero(np.isin(model.body_weldid[model.geom_bodyid], moved) & colliding),
        lower=lower,
        upper=upper,
        speed=robots.speeds(model, joints),
        home=coupled.expand(np.clip(robots.postures(model, joints), *coupled.narrowed(lower, upper))),
        coupling=coupled,
    )


def _agent(
    scene: Scene, model: mujoco.MjModel, index: int, finger: hands.Finger, friction: float, arm: int, arms: tuple[Arm, ...]
) -> Agent:  # fmt: skip
    spec = next((agent for agent in scene.agents if agent.name == scene.agent_names[index]), None)
    field = f"agents.{index}" if scene.agents else "model"
    names = tips.names(finger.tip, [model.geom(g).name for g in range(model.ngeom)].__contains__)
    pieces = np.array([model.geom(name).id for name in names], dtype=np.int64)
    tip = int(pieces[0])
    if not (model.geom_contype[tip] or model.geom_conaffinity[tip]):
        raise InputError(f"{field}.tip", "the geom does not collide", "its contype and conaffinity must not both be 0")
    kind, size = tips.surface(model, pieces, f"{field}.tip")
    tip_body = int(model.geom_bodyid[tip])
    shared = arms[arm].joints if arm >= 0 else np.zeros(0, np.int64)
    joints = np.array([j for j in _joints(model, tip_body) if j not in shared], dtype=np.int64)
    moved = np.isin(model.body_weldid, model.body_weldid[model.jnt_bodyid[joints]])
    lower, upper = _range(model, joints)
    coupled = coupling(model, joints)
    least, most = coupled.narrowed(lower, upper)
    for i in np.flatnonzero(least > most):
        name = model.joint(int(joints[i])).name
        raise InputError(
            f"{field}.tip", f"joint {name!r} and those that follow it have no value in common", "their ranges"
        )
    home = coupled.expand(np.clip(model.qpos0[model.jnt_qposadr[joints]], least, most))
    if finger.home is not None:
        home = np.array(finger.home, dtype=float)
    if len(home) != len(joints):
        raise InputError(
            f"{field}.home", f"{len(home)} values for {len(joints)} joints", "one value per joint, base to tip"
        )
    for i in np.flatnonzero(np.abs(coupled.expand(home) - home) > COUPLED):
        who, other = (model.joint(int(j)).name for j in joints[[i, coupled.master[i]]])
        reason = f"value {i + 1} is {home[i]:g}, but {who!r} follows {other!r}"
        raise InputError(f"{field}.home", reason, f"{coupled.expand(home)[i]:.7g}")
    home = coupled.expand(home)
    for i in np.flatnonzero((home < lower) | (home > upper)):
        reason = f"value {i + 1} is {home[i]:g}, outside the joint's range"
        raise InputError(f"{field}.home", reason, f"legal: {lower[i]:.4g} to {upper[i]:.4g}")
    qpos = model.qpos0.copy()
    qpos[model.jnt_qposadr[joints]] = home
    if arm >= 0:
        qpos[arms[arm].qpos] = arms[arm].home
    own = isinstance(scene.model, OwnModel)
    strength = normal_force(model, qpos, joints, coupled, tip, friction) if own else None
    return Agent(
        name=scene.agent_names[index],
        tip_geom=tip,
        tip_geoms=pieces,
        tip_kind=kind,
        tip_size=size,
        tip_body=tip_body,
        joints=joints,
        qpos=model.jnt_qposadr[joints].astype(np.int64),
        dofs=model.jnt_dofadr[joints].astype(np.int64),
        bodies=np.flatnonzero(moved),
        geoms=np.flatnonzero(moved[model.geom_bodyid] & ((model.geom_contype != 0) | (model.geom_conaffinity != 0))),
        lower=lower,
        upper=upper,
        speed=robots.speeds(model, joints)
        if finger.speed is None
        else np.broadcast_to(finger.speed, len(joints)).copy(),
        home=home,
        coupling=coupled,
        max_force=(spec.max_force if spec else None) or scene.max_force or strength or MAX_FORCE,
        friction=friction,
        arm=arm,
    )
