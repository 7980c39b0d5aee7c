"""What a scene's `model` may be: a built-in hand or team of robots, or a robot that somebody else described."""

import typing
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, StringConstraints, Tag, model_validator

from regrasp.scene.pose import Pose, Strict
from regrasp.scene.units import Angle, Coordinate, JointValue, Length, Scale, fault

Four = tuple[JointValue, JointValue, JointValue, JointValue]
Six = tuple[JointValue, JointValue, JointValue, JointValue, JointValue, JointValue]
Finger = Literal["index", "middle", "ring", "thumb"]


class BuiltIn(Strict):
    """A built-in hand or team."""

    @property
    def finger_names(self) -> tuple[str, ...]:
        """The names of the agents it offers."""
        raise NotImplementedError

    @property
    def surfaces(self) -> tuple[str, ...]:
        """Parts of it that may carry the object."""
        return ()


class PumaHand(BuiltIn):
    """Puma 560 fingers (or whole arms, at scale 1) evenly on a ring around a palm, the first on its +x side.

    With `bases` they stand at these poses in the palm's frame instead, each stretching along the x axis of its own.
    """

    hand: Literal["puma"]
    fingers: Annotated[int, Field(ge=1, le=12)] = 3
    scale: Scale = 0.3
    ring: Length = 0.33
    palm: Annotated[bool, Field(description="whether a solid disc closes the ring")] = True
    pose: Pose = Pose(position=(0.0, 0.0, 0.0))
    tip_radius: Length | None = None
    tool_length: Length | None = None
    home: Six | None = None
    bases: tuple[Pose, ...] | None = None

    @model_validator(mode="after")
    def _check_bases(self) -> "PumaHand":
        if self.bases is not None and len(self.bases) != self.fingers:
            raise fault(f"{len(self.bases)} bases for {self.fingers} fingers", "one pose for each finger")
        if self.bases is not None and self.palm:
            raise fault("bases leave no ring for a palm to close", "palm: false")
        return self

    @property
    def finger_names(self) -> tuple[str, ...]:
        """The names of the agents this hand offers."""
        return tuple(f"finger{i + 1}" for i in range(self.fingers))

    @property
    def surfaces(self) -> tuple[str, ...]:
        """Parts of the hand that may carry the object."""
        return ("palm",) if self.palm else ()


class PlanarBase(Strict):
    """Where a planar finger stands: its first hinge at [x, z], its zero direction turned by `angle` from +x to +z."""

    position: tuple[Coordinate, Coordinate]
    angle: Angle
    home: tuple[JointValue, JointValue, JointValue] | None = None


class PlanarHand(BuiltIn):
    """Fingers of three hinges about −y, moving in the plane y = 0."""

    hand: Literal["planar"]
    bases: Annotated[tuple[PlanarBase, ...], Field(min_length=1, max_length=12)]
    links: tuple[Length, Length, Length] = (0.09, 0.07, 0.05)
    link_radius: Length = 0.008
    tip_radius: Length = 0.012

    @model_validator(mode="after")
    def _check(self) -> "PlanarHand":
        if self.link_radius > self.tip_radius:
            raise fault("link_radius exceeds tip_radius", "the tip must stand proud of its link to touch the object")
        return self

    @property
    def finger_names(self) -> tuple[str, ...]:
        """The names of the agents this hand offers."""
        return tuple(f"finger{i + 1}" for i in range(len(self.bases)))


Wrist = Annotated[
    Literal["moves", "fixed"], Field(description="whether an arm that several fingers share moves with the plan")
]


class Carrier(Strict):
    """An arm that carries a hand, its base at `pose` in W: z along its first axis."""

    robot: Literal["ur5e"]
    pose: Pose
    wrist: Wrist = "moves"


class AllegroHand(BuiltIn):
    """A hand with the Allegro's joints. `pose` is of its palm's face: x along the stretched fingers, z out of the palm.

    On an arm that is where the palm is at the start.
    """

    hand: Literal["allegro"]
    side: Literal["right", "left"] = "right"
    pose: Pose = Pose(position=(0.0, 0.0, 0.0))
    arm: Carrier | None = None
    tip_radius: Length = 0.012
    home: dict[Finger, Four] = Field(default_factory=dict)

    @property
    def finger_names(self) -> tuple[str, ...]:
        """The names of the agents this hand offers."""
        return typing.get_args(Finger)

    @property
    def surfaces(self) -> tuple[str, ...]:
        """Parts of the hand that may carry the object: the palm, where it stands still."""
        return ("palm",) if self.arm is None or self.arm.wrist == "fixed" else ()


Point = tuple[Coordinate, Coordinate, Coordinate]


class Workspace(Strict):
    """An upright box in W: centre and half extents, m."""

    position: Point
    size: tuple[Length, Length, Length]


class FlyingTeam(BuiltIn):
    """Spherical tips that fly freely within boxes, each from its own place of rest."""

    hand: Literal["flying"]
    bases: Annotated[tuple[Point, ...], Field(min_length=1, max_length=12)]
    workspaces: Annotated[tuple[Workspace, ...], Field(description="one for all tips, or one for each")]
    tip_radius: Length = 0.012

    @model_validator(mode="after")
    def _check_bases(self) -> "FlyingTeam":
        if len(self.workspaces) not in (1, len(self.bases)):
            raise fault(f"{len(self.workspaces)} workspaces for {len(self.bases)} tips", "one, or one for each tip")
        for i, (base, box) in enumerate(zip(self.bases, self.boxes, strict=True)):
            if any(abs(x - c) >= h for x, c, h in zip(base, box.position, box.size, strict=True)):
                raise fault(f"base {i + 1} is outside its workspace", "every tip rests inside its box")
        return self

    @property
    def finger_names(self) -> tuple[str, ...]:
        """The names of the agents this team offers."""
        return tuple(f"tip{i + 1}" for i in range(len(self.bases)))

    @property
    def boxes(self) -> tuple[Workspace, ...]:
        """The workspace of every tip."""
        return self.workspaces * len(self.bases) if len(self.workspaces) == 1 else self.workspaces


class MobileBase(Strict):
    """Where a mobile robot stands at rest: on the floor at [x, y], its front turned by `angle` from +x towards +y."""

    position: tuple[Coordinate, Coordinate]
    angle: Angle = 0.0
    home: Annotated[
        tuple[JointValue, JointValue, JointValue] | None, Field(description="shoulder, roll and bend, rad")
    ] = None


class Room(Strict):
    """A rectangle of the floor: centre and half extents, m."""

    position: tuple[Coordinate, Coordinate] = (0.0, 0.0)
    size: tuple[Length, Length]


class MobileTeam(BuiltIn):
    """Arms of three joints on platforms that drive on the floor z = 0 in any direction, their axes inside `room`."""

    hand: Literal["mobile"]
    bases: Annotated[tuple[MobileBase, ...], Field(min_length=1, max_length=12)]
    room: Room
    shoulder: Annotated[float, Field(description="m above the floor", ge=0.45, le=2.0)] = 0.55
    tool_length: Length = 0.2
    tip_radius: Length = 0.04

    @model_validator(mode="after")
    def _check_bases(self) -> "MobileTeam":
        for i, base in enumerate(self.bases):
            if any(abs(x - c) >= h for x, c, h in zip(base.position, self.room.position, self.room.size, strict=True)):
                raise fault(f"base {i + 1} is outside the room", "every platform stands inside the room")
        return self

    @property
    def finger_names(self) -> tuple[str, ...]:
        """The names of the agents this team offers."""
        return tuple(f"robot{i + 1}" for i in range(len(self.bases)))


class URTeam(BuiltIn):
    """UR5e arms at the poses `bases`, each stretching along the x of its own, z along its first axis."""

    hand: Literal["ur5e"]
    bases: Annotated[tuple[Pose, ...], Field(min_length=1, max_length=12)]
    tool_length: Length = 0.2
    tip_radius: Length = 0.03
    home: Six | None = None

    @property
    def finger_names(self) -> tuple[str, ...]:
        """The names of the agents this team offers."""
        return tuple(f"arm{i + 1}" for i in range(len(self.bases)))


class OwnModel(Strict):
    """A robot that somebody else described, its world placed at `pose`; its agents are named by their tips.

    posture: where joints rest that no agent has to itself, by their names in the file, rad or m.
    """

    pose: Pose = Pose(position=(0.0, 0.0, 0.0))
    wrist: Wrist = "moves"
    posture: dict[str, JointValue] = Field(default_factory=dict)

    @property
    def surfaces(self) -> tuple[str, ...]:
        """Parts of the robot that may carry the object."""
        return ()


class ModelFile(OwnModel):
    """An MJCF or URDF file. `packages`: folders of the packages that a URDF's package:// paths name."""

    file: Annotated[str, StringConstraints(min_length=1)]
    packages: dict[str, str] = Field(default_factory=dict)


class MenagerieModel(OwnModel):
    """A model of MuJoCo Menagerie: its folder, and its file where the folder holds more than one."""

    menagerie: Annotated[str, StringConstraints(pattern=r"^\w[\w.-]*(/\w[\w.-]*)?$")]


def _tag(value: Any) -> str | None:
    if isinstance(value, dict):
        own = next((key for key in ("file", "menagerie") if key in value), None)
        return f"model: {own or value.get('hand')}"
    return next((tag for tag, kind in MODELS.items() if isinstance(value, kind)), None)


# Tags hold a colon, so that `load` can tell them from field names in the paths of pydantic's errors.
MODELS: dict[str, type[Strict]] = {
    "model: puma": PumaHand,
    "model: planar": PlanarHand,
    "model: allegro": AllegroHand,
    "model: flying": FlyingTeam,
    "model: mobile": MobileTeam,
    "model: ur5e": URTeam,
    "model: file": ModelFile,
    "model: menagerie": MenagerieModel,
}
Model = Annotated[
    Annotated[PumaHand, Tag("model: puma")]
    | Annotated[PlanarHand, Tag("model: planar")]
    | Annotated[AllegroHand, Tag("model: allegro")]
    | Annotated[FlyingTeam, Tag("model: flying")]
    | Annotated[MobileTeam, Tag("model: mobile")]
    | Annotated[URTeam, Tag("model: ur5e")]
    | Annotated[ModelFile, Tag("model: file")]
    | Annotated[MenagerieModel, Tag("model: menagerie")],
    Discriminator(
        _tag,
        custom_error_type="scene",
        custom_error_message="neither a built-in hand nor a model of your own",
        custom_error_context={
            "hint": "legal: hand: puma, planar, allegro, flying, mobile or ur5e; file: robot.urdf; "
            "menagerie: wonik_allegro/right_hand"
        },
    ),
]
