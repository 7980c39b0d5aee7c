"""What planning returns: a plan, or the reason there is none; and what it tells while it works."""

from collections.abc import Callable
from dataclasses import dataclass

from regrasp.plan import Plan
from regrasp.planner.motion import Motion
from regrasp.planner.path import Pose


@dataclass(frozen=True)
class Failure:
    """Why no plan was found.

    constraint: which condition of paper §2 failed ('collision', 'reach', 'equilibrium', 'route', 'grasp', 'start', 'goal'),
    or 'time': the limit of the run.
    where: the place on the way, in words ('arc 2 of 3, interval 14').
    agent: the agent or body concerned, '' where it is the object's.
    reason: what was found. remedy: what the user can change.
    """

    constraint: str
    where: str
    agent: str
    reason: str
    remedy: str

    def __str__(self) -> str:
        who = f" {self.agent}:" if self.agent else ""
        return f"{self.constraint}: {self.where}:{who} {self.reason} ({self.remedy})"


@dataclass(frozen=True)
class Progress:
    """One report of a long computation: stage in words, done of total steps, current and best energy of Eq. (1).

    route: the object's poses between which the local planner is at work or has been. motions: makes the motions from the start
    on, the last one of the best V found yet; it costs some evaluations, and is to be called before the report returns.
    """

    stage: str
    done: int
    total: int
    energy: float
    best: float
    route: tuple[Pose, ...] = ()
    motions: Callable[[], list[Motion]] | None = None


@dataclass(frozen=True)
class Tried:
    """An arc of the route that the local planner was given.

    kind: how the object goes ('slide', 'pivot', 'straight', …), from start to goal. how: what made its motion ('stay', 'new
    grasp', 'annealing'), '' where nothing did; failure: why not, None where something did.
    """

    kind: str
    start: Pose
    goal: Pose
    how: str
    failure: Failure | None

    def __str__(self) -> str:
        way = f"{self.kind} from {_place(self.start)} to {_place(self.goal)}"
        return f"{way}: {self.failure or self.how}"


def _place(pose: Pose) -> str:
    """Where a pose is, in mm."""
    return "(" + ", ".join(f"{1e3 * x:.0f}" for x in pose[1]) + ") mm"


@dataclass(frozen=True)
class Outcome:
    """The result of planning: a feasible plan, or a failure; with one for lack of time also the best plan so far.

    tried: the arcs that the local planner was given, in order. repairs: what was put right in the robot, and what planning
    takes for its meshes, each in a sentence.
    """

    plan: Plan | None
    failure: Failure | None
    tried: tuple[Tried, ...] = ()
    repairs: tuple[str, ...] = ()


Report = Callable[[Progress], None]
