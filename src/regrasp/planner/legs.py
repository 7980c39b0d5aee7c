"""One leg of the route (Fig. 1): who holds the object along it, and with which contact motions.

The simplest first: fingers that can keep their contacts keep them. Where they can't and the object rests on supports, all may
take hold anew; in the air those who hold it may hand it over to others who are off. Only what is left is searched by annealing
(paper §4). Arms that carry hands first go with the object as far as they can; where the fingers fail so, less far.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.surfaces import MESH
from regrasp.planner.ahead import OUT
from regrasp.planner.arcs import Arc
from regrasp.planner.assemble import Segment
from regrasp.planner.chain import ContactMotions
from regrasp.planner.clock import Clock
from regrasp.planner.configurations import Grasp
from regrasp.planner.follow import wanders
from regrasp.planner.grasp import continued, nothing
from regrasp.planner.hand import Hand
from regrasp.planner.local import ArcResult, failure_of, plan_arc, terms_of
from regrasp.planner.motion import Motion, detail
from regrasp.planner.motions import OFF, ONTO, STAY
from regrasp.planner.outcome import Failure, Progress, Report
from regrasp.planner.path import Path, Pose, head
from regrasp.planner.pieces import paths_of, pieces_of, rest_at, ways_along, with_ahead
from regrasp.planner.rolling import roll_within
from regrasp.planner.scan import new_scan
from regrasp.planner.stances import Stance, find_grasp
from regrasp.planner.task import Task

Array = NDArray[np.float64]
Codes = NDArray[np.int16]

DENSER = (2, 5)  # times as many candidates of agents of few joints, at first and where no contacts on those last
COARSE = 3  # intervals at once in which contacts on a mesh are followed at first: they cost ten times those on other surfaces
STANCES = 3  # grasps that are tried where agents take hold of what supports carry
ORDERS = 6  # in which the agents take hold anew that are tried
HALVINGS = 3  # of an arc along which no contacts can be kept
SHORTEST = 8  # intervals of an arc that is halved
HAND_OVERS = 4  # scans for grasps onto which the object is handed over in the air
STAYED, TOOK_HOLD, ANNEALED = "stay", "new grasp", "annealing"


@dataclass(frozen=True)
class Planned:
    """Segments of a leg up to the first that fails, the grasp at their end, how it was planned."""

    segments: list[Segment]
    grasp: Grasp | None
    how: str
    failure: Failure | None


def blocked(stage: str) -> Failure:
    """No arm has a way along the object's."""
    return Failure(
        "collision", stage, "an arm", "cannot go with the object, nor stay", "more room, or another pose of it"
    )


def stances_for(
    task: Task, path: Path, rng: np.random.Generator, off: tuple[int, ...], holding: Grasp | None = None,
    denser: int = 1, stride: int = 1,
) -> tuple[Stance, ...] | Failure:  # fmt: skip
    """Grasps at the start of a path, those first with which the agents can probably stay in contact along it.

    denser: times as many candidates as for a relocation are looked at; stride: intervals at once (`ahead.look_over`).
    """
    local = task.settings.local
    relocation = replace(local.relocation, candidates=denser * local.relocation.candidates)
    scan, terms = new_scan(task.hand, path, relocation), terms_of(task.hand, local)
    return find_grasp(task.hand, path, scan, terms, off, task.names, task.settings.grasp, rng, holding, stride)


def moved(task: Task, path: Path, grasp: Grasp, V: Codes, stage: str) -> tuple[Segment, Grasp] | Failure:
    """The segment that V makes of the path, if it breaks no constraint."""
    local = task.settings.local
    terms, scan = terms_of(task.hand, local), new_scan(task.hand, path, local.relocation)
    problem = ContactMotions(task.hand, path, scan, terms, grasp, V)

    def motion_of(part: Path) -> Motion:
        return detail(task.hand, part, terms, problem.found, problem.current, problem.work, task.names)

    # Where a V fails at the end of an interval, what comes after it is not looked at at every sample.
    motion = motion_of(head(path, min(problem.unbroken() + 1, len(V))))
    if not motion.violations and len(motion.V) < len(V):
        motion = motion_of(path)
    if motion.violations:
        return failure_of(motion, stage, len(V))
    return Segment(motion, np.array([problem.energy()])), problem.grasp(len(V))


def roll(hand: Hand, path: Path, commands: Array, grasp: Grasp, V: Codes) -> None:
    """Write into V how the agents that hold the object and wander keep their contacts, as far as they can."""
    for i in np.flatnonzero(grasp.holds).tolist():
        if not wanders(hand, i):
            continue
        mine = slice(hand.chains.start[i], hand.chains.start[i + 1])
        p_OC, p_TC, R_OT, q = grasp.p_OC[i].copy(), grasp.p_TC[i].copy(), grasp.R_OT[i].copy(), grasp.q[mine].copy()
        R_WL, p_WL = np.empty((len(q) + 1, 3, 3)), np.empty((len(q) + 1, 3))
        for j in range(len(V)):
            code = roll_within(hand, path, commands, j, j + 1, i, p_OC, p_TC, R_OT, q, R_WL, p_WL)
            if code < 0:
                break
            V[j, i] = code


def stay(task: Task, path: Path, grasp: Grasp, stage: str) -> tuple[Segment, Grasp] | Failure:
    """All agents keep what they do: those that hold their contacts, rolling or not, the others off."""
    still = continued(nothing(grasp), len(path.R_WO))
    V = still.copy()
    roll(task.hand, path, terms_of(task.hand, task.settings.local).commands, grasp, V)
    made = moved(task, path, grasp, V, stage)
    if isinstance(made, Failure) and np.any(still != V):
        # A roll that leaves a joint more room may take the tip to where it touches something.
        unmoved = moved(task, path, grasp, still, stage)
        return made if isinstance(unmoved, Failure) else unmoved
    return made


def take_hold(task: Task, pose: Pose, grasp: Grasp, stance: Stance, stage: str) -> tuple[Segment, Grasp] | Failure:
    """The change of grasp at a subgoal: while the object rests on its supports, every agent may go where it is wanted.

    One after another, straight onto its new contact or after all have let go, in the first order that is free of collisions.
    In the air all take hold before any lets go.
    """
    k, there = len(task.names), stance.candidates
    held = [i for i in range(k) if grasp.holds[i]]
    wanted = [i for i in range(k) if there[i] != OUT]
    here = np.where(grasp.holds == 1, STAY, OFF).astype(np.int16)
    paths: dict[int, Path] = {}  # by the number of steps
    last: Failure | None = None
    for steps in changes(task, pose, held, wanted, there):
        V, now = np.empty((len(steps), k), np.int16), here.copy()
        for j, (i, code) in enumerate(steps):
            V[j] = now
            V[j, i] = code
            now[i] = OFF if code == OFF else STAY
        if len(steps) not in paths:
            paths[len(steps)] = rest_at(task, pose, len(steps), grasp)
        made = moved(task, paths[len(steps)], grasp, V, stage)
        if not isinstance(made, Failure):
            return made
        last = made
    assert last is not None
    return last


def changes(
    task: Task, pose: Pose, held: list[int], wanted: list[int], there: NDArray[np.int64]
) -> Iterator[list[tuple[int, int]]]:
    """The orders in which agents may let go and take hold, each as (agent, code) step by step."""

    def onto(order: tuple[int, ...]) -> list[tuple[int, int]]:
        return [(i, ONTO + int(there[i])) for i in order if i in wanted]

    if task.router.rests(pose):
        for order in itertools.islice(itertools.permutations(range(len(there))), ORDERS):
            leave = [(i, OFF) for i in order if i in held and i not in wanted]
            yield leave + onto(order)
            yield [(i, OFF) for i in order if i in held] + onto(order)
        return
    freed = [i for i in held if i not in wanted]
    for arrive, part in itertools.product(*map(_some_orders, (wanted, freed))):
        yield onto(arrive) + [(i, OFF) for i in part]


def _some_orders(agents: list[int]) -> list[tuple[int, ...]]:
    return list(itertools.islice(itertools.permutations(agents), ORDERS))


def plan_leg(
    task: Task, arcs: list[Arc], grasp: Grasp | None, first: int, rng: np.random.Generator, report: Report, clock: Clock
) -> Planned | Failure:  # fmt: skip
    """Segments of the first of the arcs, from the grasp at hand; None where the object has not been touched yet.

    The coming arcs are looked at when agents take hold, so that they need not again soon.
    """
    simple = without_search(task, arcs, grasp, first, rng, clock, HALVINGS)
    if isinstance(simple, Planned) and simple.failure is None:
        return simple
    starts: list[tuple[list[Segment], Grasp]] = [] if grasp is None else [([], grasp)]
    if isinstance(simple, Planned) and simple.grasp is not None:
        starts.append((simple.segments, simple.grasp))
    found: Planned | Failure = simple
    for before, now in starts:
        found = annealed(task, arcs, before, now, first, rng, report, clock)
        if found.failure is None or clock.up():
            return found
    return found


def without_search(
    task: Task, arcs: list[Arc], grasp: Grasp | None, first: int, rng: np.random.Generator, clock: Clock, halvings: int
) -> Planned | Failure:  # fmt: skip
    """The first of the arcs with contacts that stay, from the grasp at hand, or a new one where the object rests.

    In the air agents that are off may take over, if there are enough of them. Where that fails, half of the arc, and from there
    the other half. A Planned with a failure has taken hold anew, but can't keep those contacts.
    """
    stage, wholes = f"segment {first + 1}", paths_of(task, arcs[:1], grasp)
    if not wholes:
        return blocked(stage)
    carried, wandering = wholes[0].support_mode.shape[1] > 0, any(wanders(task.hand, i) for i in range(len(task.names)))
    off = task.off if first == 0 else ()
    idle = len(off) if grasp is None else int(np.sum(grasp.holds == 0))
    others = idle >= task.hand.needed  # enough to hold the object by themselves
    failed: Planned | Failure | None = None
    if grasp is not None:
        for whole in wholes:
            made = stay(task, whole, grasp, stage)
            if not isinstance(made, Failure):
                return Planned([made[0]], made[1], STAYED, None)
            failed = failed or made
    if grasp is None or task.router.rests(arcs[0].start):
        # Few contacts of agents of few joints can be kept, so that more candidates are worth their time.
        many = grasp is None and wandering and not carried
        counts = tuple(dict.fromkeys((len(arcs), 1)))
        strides = (COARSE, 1) if many and task.hand.kind_O == MESH else (1,)
        scans = [(count, DENSER[0] if many else 1, stride) for stride in strides for count in counts]
        scans += [(1, DENSER[1], 1)] if many else []
        for (count, denser, stride), whole in itertools.product(scans, wholes):
            ahead = [whole] if count == 1 else paths_of(task, arcs[:count], grasp)
            stances = stances_for(task, (ahead or [whole])[0], rng, off, None, denser, stride)
            if isinstance(stances, Failure):
                failed = failed or stances
                continue
            for stance in lasting(stances) if wandering else stances[: STANCES if carried or others else 1]:
                held = taken(task, arcs[0], whole, grasp, stance, stage)
                if isinstance(held, Planned) and held.failure is None:
                    return held
                if isinstance(held, Planned) or failed is None:
                    failed = held
                if clock.up():
                    return failed
    if grasp is not None and others and not carried:
        passed = handed_over(task, arcs[0], wholes[0], grasp, rng, stage)
        if isinstance(passed, Planned) and passed.failure is None:
            return passed
        if clock.up():
            return failed or passed
    room = others or task.router.rests(arcs[0].pose(0.5))
    if halvings > 0 and not clock.up() and len(wholes[0].R_WO) >= SHORTEST and room:
        one, two = arcs[0].halves()
        there = without_search(task, [one, two, *arcs[1:]], grasp, first, rng, clock, halvings - 1)
        if isinstance(there, Planned) and there.failure is None:
            count = first + len(there.segments)
            rest = without_search(task, [two, *arcs[1:]], there.grasp, count, rng, clock, halvings - 1)
            if isinstance(rest, Planned) and rest.failure is None:
                return Planned(there.segments + rest.segments, rest.grasp, TOOK_HOLD, None)
    assert failed is not None
    return failed


def lasting(stances: tuple[Stance, ...]) -> tuple[Stance, ...]:
    """Those whose contacts can probably all be kept, else the first."""
    return tuple(stance for stance in stances if stance.kept == 1.0) or stances[:1]


def taken(task: Task, arc: Arc, whole: Path, grasp: Grasp | None, stance: Stance, stage: str) -> Planned | Failure:
    """The arc with the contacts of a stance, which the agents take at its start, and keep."""
    before: list[Segment] = []
    now = stance.grasp
    if grasp is not None:
        changed = take_hold(task, arc.start, grasp, stance, stage)
        if isinstance(changed, Failure):
            return changed
        before, now = [changed[0]], changed[1]
    made = stay(task, whole, now, stage)
    if isinstance(made, Failure):
        return Planned(before, now, TOOK_HOLD, made)
    return Planned([*before, made[0]], made[1], TOOK_HOLD, None)


def handed_over(
    task: Task, arc: Arc, whole: Path, grasp: Grasp, rng: np.random.Generator, stage: str
) -> Planned | Failure:  # fmt: skip
    """The arc held by agents that are off: they take hold before it, and those who held the object let go."""
    last: Planned | Failure | None = None
    for _ in range(HAND_OVERS):
        stances = stances_for(task, whole, rng, tuple(np.flatnonzero(grasp.holds).tolist()), grasp)
        if isinstance(stances, Failure):
            return last or stances
        for stance in stances:
            if last is not None and not all_arrive(task, arc.start, grasp, stance, stage):
                continue
            last = taken(task, arc, whole, grasp, stance, stage)
            if isinstance(last, Planned) and last.failure is None:
                return last
    assert last is not None
    return last


def all_arrive(task: Task, pose: Pose, grasp: Grasp, stance: Stance, stage: str) -> bool:
    """Whether each agent, alone, finds its way to its contact of the stance beside the grasp at hand."""
    here, path = np.where(grasp.holds == 1, STAY, OFF).astype(np.int16), rest_at(task, pose, 1, grasp)
    for i in np.flatnonzero(stance.candidates != OUT):
        V = here[None].copy()
        V[0, i] = ONTO + stance.candidates[i]
        if isinstance(moved(task, path, grasp, V, stage), Failure):
            return False
    return True


def told(report: Report, planned: list[Segment]) -> Report:
    """The report with the motions of what is planned before those that it is told."""

    def tell(progress: Progress) -> None:
        motions = progress.motions
        before = [segment.motion for segment in planned]
        report(replace(progress, motions=None if motions is None else lambda: before + motions()))

    return tell


def annealed(
    task: Task, arcs: list[Arc], before: list[Segment], grasp: Grasp, first: int, rng: np.random.Generator,
    report: Report, clock: Clock,
) -> Planned:  # fmt: skip
    """Local plans of the pieces of the first arc, each from where the one before ends."""
    planned, pieces = list(before), pieces_of(task, arcs[0])
    # Where the object rests all may take hold anew.
    after = [] if len(arcs) == 1 or task.router.rests(arcs[1].start) else pieces_of(task, arcs[1])[:1]
    report = told(report, planned)
    onward = nothing(grasp)
    for at, piece in enumerate(pieces):
        stage, parts = f"segment {first + len(planned) + 1}", len(pieces) - at + len(arcs) - 1
        result: ArcResult | None = None
        longer, ahead = with_ahead(task, piece, pieces[at + 1 :] or after)
        for path in ways_along(task, *longer, grasp):
            V, local = continued(onward, len(path.R_WO)), task.settings.local
            result = plan_arc(task.hand, path, grasp, task.names, local, rng, report, stage, clock, parts, V, ahead)
            if result.failure is None or clock.up():
                break
        if result is None:
            return Planned(planned, grasp, ANNEALED, blocked(stage))
        planned.append(Segment(result.motion, result.energy))
        grasp, onward = result.grasp, result.onward
        if result.failure:
            return Planned(planned, grasp, ANNEALED, result.failure)
    return Planned(planned, grasp, ANNEALED, None)
