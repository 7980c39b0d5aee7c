"""Teams of robots in a scene file: free-flying tips, arms on mobile platforms, UR5e arms."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from regrasp.scene.pose import Pose, Strict
from regrasp.scene.units import Angle, Coordinate, JointValue, Length, fault

Point = tuple[Coordinate, Coordinate, Coordinate]


class Workspace(Strict):
    """An upright box in W: centre and half extents, m."""

    position: Point
    size: tuple[Length, Length, Length]


class FlyingTeam(Strict):
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
    def boxes(self) -> tuple[Workspace, ...]:
        """The workspace of every tip."""
        return self.workspaces * len(self.bases) if len(self.workspaces) == 1 else self.workspaces

    @property
    def finger_names(self) -> tuple[str, ...]:
        """The names of the agents this team offers."""
        return tuple(f"tip{i + 1}" for i in range(len(self.bases)))


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


class MobileTeam(Strict):
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


class URTeam(Strict):
    """UR5e arms at the poses `bases`, each stretching along the x of its own, z along its first axis."""

    hand: Literal["ur5e"]
    bases: Annotated[tuple[Pose, ...], Field(min_length=1, max_length=12)]
    tool_length: Length = 0.2
    tip_radius: Length = 0.03
    home: tuple[JointValue, JointValue, JointValue, JointValue, JointValue, JointValue] | None = None

    @property
    def finger_names(self) -> tuple[str, ...]:
        """The names of the agents this team offers."""
        return tuple(f"arm{i + 1}" for i in range(len(self.bases)))
