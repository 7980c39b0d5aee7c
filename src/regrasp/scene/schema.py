"""The scene file: robot, object, surroundings and task. docs/scenes.md explains every field."""

import math
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Discriminator, Field, StringConstraints, Tag, model_validator
from pydantic_core import PydanticCustomError

from regrasp.scene.forms import Model, OwnModel
from regrasp.scene.pose import Pose, Strict, conjugate, multiply
from regrasp.scene.units import (
    Acceleration,
    Coordinate,
    Density,
    Force,
    Friction,
    JointSpeed,
    JointValue,
    Length,
    Mass,
    Quantity,
    Scale,
    fault,
)

Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][\w.-]*$")]
FileName = Annotated[str, StringConstraints(min_length=1)]
Rounding = Annotated[float, Quantity("m", 0.0, 10.0, high_hint="metres, not millimetres?")]
Resolution = Annotated[float, Quantity("m", 1e-4, 0.1, high_hint="metres, not millimetres?")]
Freedom = Literal["x", "y", "z", "rx", "ry", "rz"]
FREEDOMS: tuple[Freedom, ...] = ("x", "y", "z", "rx", "ry", "rz")
RESERVED = ("object", "palm", "world")
NUMBERS = {"plane": "", "sphere": "radius", "ellipsoid": "semi-axes a, b, c", "capsule": "radius, half length",
           "cylinder": "radius, half height", "box": "half extents x, y, z", "mesh": ""}  # fmt: skip
ROUNDED = ("cylinder", "box")


def _check_size(shape: str, size: Sequence[float]) -> None:
    wanted = NUMBERS[shape].count(",") + 1 if NUMBERS[shape] else 0
    if len(size) != wanted:
        raise fault(f"size has {len(size)} numbers for a {shape}", f"legal: {NUMBERS[shape] or 'no size'}")


class Massive(Strict):
    """What has a mass: given, or that of a uniform density."""

    mass: Mass | None = None
    density: Density | None = None

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if (self.mass is None) == (self.density is None):
            raise fault("needs mass or density, not both", "mass: in kg, or density: in kg/m³ (water 1000)")
        return self


class Primitive(Strict):
    """A convex solid, frame at its centre, z along the axis of revolution."""

    shape: Literal["sphere", "ellipsoid", "capsule", "cylinder", "box"]
    size: tuple[Length, ...]
    rounding: Rounding = 0.0

    @model_validator(mode="after")
    def _check(self) -> Self:
        _check_size(self.shape, self.size)
        if self.shape not in ROUNDED and self.rounding > 0.0:
            raise fault(f"a {self.shape} has no edges to round", "leave rounding out")
        if self.shape in ROUNDED and not 0.0 < self.rounding < min(self.size):
            raise fault(
                f"rounding {self.rounding:g} of the {self.shape}'s edges must lie between 0 and {min(self.size):g} m",
                "contact kinematics needs a smooth surface: a few millimetres, say 0.003",
            )
        return self


class Object(Primitive, Massive):
    """A convex object to be moved, of uniform density."""


class Piece(Primitive):
    """One solid of a union, at `pose` in the union's frame."""

    pose: Pose = Pose(position=(0.0, 0.0, 0.0))


class UnionObject(Massive):
    """An object made of solids that overlap or touch, of uniform density; frame O is the one their poses count in."""

    shape: Literal["union"]
    parts: Annotated[tuple[Piece, ...], Field(min_length=1)]
    resolution: Resolution | None = None


class MeshObject(Massive):
    """An object whose surface is a mesh in a file, opened by `rounding`; frame O is the file's, scaled.

    resolution: m between the nodes at which the signed distance is kept.
    """

    shape: Literal["mesh"]
    file: FileName
    scale: Scale = 1.0
    rounding: Length = 0.002
    resolution: Resolution | None = None


class Environment(Strict):
    """A fixed body. The plane is the half space below z = 0 of its own frame; a mesh's frame is its file's, scaled."""

    name: Name
    shape: Literal["plane", "box", "sphere", "capsule", "cylinder", "mesh"]
    size: tuple[Length, ...] = ()
    file: FileName | None = None
    scale: Scale = 1.0
    pose: Pose = Pose(position=(0.0, 0.0, 0.0))
    friction: Friction | None = None

    @model_validator(mode="after")
    def _check(self) -> "Environment":
        _check_size(self.shape, self.size)
        if (self.file is None) == (self.shape == "mesh"):
            raise fault(
                f"a {self.shape} {'needs a' if self.file is None else 'has no'} file", "shape: mesh, file: shelf.stl"
            )
        if self.shape != "mesh" and self.scale != 1.0:
            raise fault(f"a {self.shape} has no scale", "its size says all")
        return self


class Tip(Strict):
    """A fingertip that differs from what the robot has: a box of it with rounded edges (`geom`), or a shape.

    The shape is put on the `body` of a model of one's own, at `pose` in its frame, or in the place of a built-in hand's tip.
    """

    geom: str | None = None
    body: str | None = None
    shape: Literal["sphere", "ellipsoid", "capsule", "box"] | None = None
    size: tuple[Length, ...] = ()
    rounding: Annotated[float, Quantity("m", 0.0, 10.0, high_hint="metres, not millimetres?")] = 0.0
    pose: Pose = Pose(position=(0.0, 0.0, 0.0))

    @model_validator(mode="after")
    def _check(self) -> "Tip":
        if (self.geom is None) == (self.shape is None):
            raise fault("needs geom or shape, not both", "geom: a box of the model, or shape and size")
        if self.geom is not None and (self.body is not None or self.size):
            raise fault("a geom of the model has its place and size", "geom and rounding only")
        if self.geom is not None and self.rounding == 0.0:
            raise fault("rounding is missing", "tip: NAME takes the geom as it is")
        if self.shape is not None:
            _ = self.solid
        return self

    @property
    def solid(self) -> Object:
        """The shape as a body of water."""
        assert self.shape is not None
        return Object(shape=self.shape, size=self.size, rounding=self.rounding, mass=1.0)


def _tip_tag(value: Any) -> str:
    return "tip: shape" if isinstance(value, dict | Tip) else "tip: name"


class AgentSpec(Strict):
    """One finger or arm. For a built-in hand only what differs from the hand's own values is written."""

    name: Name
    tip: (
        Annotated[Annotated[str, Tag("tip: name")] | Annotated[Tip, Tag("tip: shape")], Discriminator(_tip_tag)] | None
    ) = None
    max_force: Force | None = None
    friction: Friction | None = None
    speed: JointSpeed | None = None
    home: tuple[JointValue, ...] | None = None

    @property
    def tip_name(self) -> str:
        """What the tip's geom is called in a model of one's own."""
        if isinstance(self.tip, Tip):
            return self.tip.geom or f"{self.name}/tip"
        return self.tip or ""


class Contact(Strict):
    """One contact of the start grasp: `point` in frame O (the nearest surface point counts) or the agent's `joints`."""

    agent: str
    point: tuple[Coordinate, Coordinate, Coordinate] | None = None
    joints: tuple[JointValue, ...] | None = None

    @model_validator(mode="after")
    def _one(self) -> "Contact":
        if (self.point is None) == (self.joints is None):
            raise fault("needs point or joints, not both", "point: [x, y, z] in the object's frame, in metres")
        return self


def _grasp_tag(value: Any) -> str:
    return "grasp: contacts" if isinstance(value, list | tuple) else "grasp: auto"


def _supports_tag(value: Any) -> str:
    return "supports: auto" if value == "auto" else "supports: names"


def _object_tag(value: Any) -> str:
    shape = value.get("shape") if isinstance(value, dict) else getattr(value, "shape", None)
    return f"object: {shape}" if shape in ("mesh", "union") else "object: solid"


OBJECTS: dict[str, type[Strict]] = {"object: solid": Object, "object: union": UnionObject, "object: mesh": MeshObject}
AnyObject = Annotated[
    Annotated[Object, Tag("object: solid")]
    | Annotated[UnionObject, Tag("object: union")]
    | Annotated[MeshObject, Tag("object: mesh")],
    Discriminator(_object_tag),
]
Grasp = Annotated[
    Annotated[Literal["auto"], Tag("grasp: auto")] | Annotated[tuple[Contact, ...], Tag("grasp: contacts")],
    Discriminator(_grasp_tag),
]
Supports = Annotated[
    Annotated[Literal["auto"], Tag("supports: auto")] | Annotated[tuple[str, ...], Tag("supports: names")],
    Discriminator(_supports_tag),
]


class Start(Strict):
    """The start: the object's pose, the contacts (`auto`: the planner chooses), the agents that stay off."""

    pose: Pose
    grasp: Grasp = "auto"
    off: tuple[str, ...] = ()


class Tolerance(Strict):
    """How near the goal counts as there: m and rad."""

    position: Length = 1e-3
    rotation: Annotated[float, Quantity("rad", 0.0, math.pi, above=True, high_hint="radians, not degrees?")] = 1e-2


class Goal(Strict):
    """Where the object shall be."""

    pose: Pose
    tolerance: Tolerance = Tolerance()


class Scene(Strict):
    """A whole task. Lengths in m, angles in rad, masses in kg, forces in N; quaternions w, x, y, z."""

    name: Name
    description: str = ""
    model: Model
    object: AnyObject
    agents: tuple[AgentSpec, ...] = ()
    environment: tuple[Environment, ...] = ()
    supports: Supports = ()
    friction: Friction = 0.7
    max_force: Force | None = None
    gravity: tuple[Acceleration, Acceleration, Acceleration] = (0.0, 0.0, -9.81)
    freedoms: Annotated[tuple[Freedom, ...], Field(min_length=1)] = FREEDOMS
    start: Start
    goal: Goal
    planner: dict[str, Any] = Field(default_factory=dict)
    control: dict[str, Any] = Field(default_factory=dict)

    @property
    def agent_names(self) -> tuple[str, ...]:
        """The agents that take part, in order: those listed, or every finger of the built-in hand."""
        if isinstance(self.model, OwnModel) or self.agents:
            return tuple(agent.name for agent in self.agents)
        return self.model.finger_names

    @property
    def support_names(self) -> tuple[str, ...]:
        """What may be named in `supports`: the environment, and the palm of a hand that has one."""
        return tuple(body.name for body in self.environment) + self.model.surfaces

    @property
    def carriers(self) -> tuple[str, ...]:
        """The bodies that may touch and carry the object: those named in `supports`, or with `auto` all that may be."""
        return self.support_names if self.supports == "auto" else self.supports

    @model_validator(mode="after")
    def _names(self) -> "Scene":
        if problems := [*_agent_problems(self), *_name_problems(self), *_freedom_problems(self)]:
            raise PydanticCustomError("scenes", "{problems}", {"problems": problems})
        return self


Problem = tuple[str, str, str]  # field, reason, hint


def _repeated(names: Sequence[str]) -> Iterator[tuple[int, str]]:
    return ((i, name) for i, name in enumerate(names) if name in names[:i])


def _agent_problems(scene: Scene) -> Iterator[Problem]:
    if isinstance(scene.model, OwnModel):
        if not scene.agents:
            yield "agents", "missing", "a model of your own needs its agents listed: name and tip geom"
        for i, agent in enumerate(scene.agents):
            if agent.tip is None:
                yield f"agents.{i}.tip", "missing", "the name of the fingertip's geom in the model"
            elif isinstance(agent.tip, Tip) and agent.tip.shape is not None and agent.tip.body is None:
                yield f"agents.{i}.tip.body", "missing", "the body of the model that gets this tip"
        return
    fingers = scene.model.finger_names
    for i, agent in enumerate(scene.agents):
        if agent.name not in fingers:
            yield f"agents.{i}.name", f"no finger {agent.name!r}", f"legal: {', '.join(fingers)}"
        if agent.tip is not None and not (isinstance(agent.tip, Tip) and agent.tip.shape and agent.tip.body is None):
            yield f"agents.{i}.tip", "the tips of a built-in hand are fixed", "leave tip out, or give shape and size"


def _name_problems(scene: Scene) -> Iterator[Problem]:
    for field, names in (
        ("agents.{}.name", [agent.name for agent in scene.agents]),
        ("environment.{}.name", [body.name for body in scene.environment]),
        ("supports.{}", scene.carriers),
        ("freedoms.{}", scene.freedoms),
        ("start.off.{}", scene.start.off),
    ):
        for i, name in _repeated(names):
            yield field.format(i), f"{name!r} appears twice", "each name once"
    for i, body in enumerate(scene.environment):
        if body.name in RESERVED:
            yield f"environment.{i}.name", f"{body.name!r} is reserved", f"not {', '.join(RESERVED)}"
    for i, name in enumerate(scene.carriers):
        if name not in scene.support_names:
            yield f"supports.{i}", f"no surface {name!r}", f"legal: {', '.join(scene.support_names) or 'none'}"
    legal = ", ".join(scene.agent_names)
    for i, name in enumerate(scene.start.off):
        if name not in scene.agent_names:
            yield f"start.off.{i}", f"no agent {name!r}", f"legal: {legal}"
    if scene.start.grasp == "auto":
        return
    holding = [contact.agent for contact in scene.start.grasp]
    for i, name in enumerate(holding):
        if name not in scene.agent_names:
            yield f"start.grasp.{i}.agent", f"no agent {name!r}", f"legal: {legal}"
        elif name in scene.start.off:
            yield f"start.grasp.{i}.agent", f"{name!r} is also in start.off", "an agent holds or is off"
        elif name in holding[:i]:
            yield f"start.grasp.{i}.agent", f"{name!r} appears twice", "one contact per agent"
    if missing := [name for name in scene.agent_names if name not in (*holding, *scene.start.off)]:
        yield (
            "start.grasp",
            f"says nothing of {', '.join(missing)}",
            "list it here or in start.off, or write grasp: auto",
        )


def _freedom_problems(scene: Scene) -> Iterator[Problem]:
    start, goal = scene.start.pose, scene.goal.pose
    moved = np.abs(goal.p - start.p) > scene.goal.tolerance.position
    turned = np.abs(2 * multiply(goal.wxyz, conjugate(start.wxyz))[1:]) > scene.goal.tolerance.rotation
    if sum(freedom.startswith("r") for freedom in scene.freedoms) == 2:
        turned[:] = False  # turns about two axes make turns about the third
    changed = [name for name, change in zip(FREEDOMS, (*moved, *turned), strict=True) if change]
    if frozen := [name for name in changed if name not in scene.freedoms]:
        yield "goal.pose", f"differs from the start in {', '.join(frozen)}", f"freedoms: {', '.join(scene.freedoms)}"
