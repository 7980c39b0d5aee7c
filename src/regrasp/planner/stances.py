"""Stances: grasps found by a scan (`auto`), for the way that lies ahead."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.chains import forward
from regrasp.planner.ahead import OUT, Ahead, longest, look_over, nothing_ahead
from regrasp.planner.chain import ContactMotions
from regrasp.planner.choices import Choice, Fixed, Weighing, choices, new_weighing
from regrasp.planner.collision import hits, object_row, place_agent, tip_hits
from regrasp.planner.configurations import Grasp, bodies_along
from regrasp.planner.follow import wanders
from regrasp.planner.grasp import build_grasp, continued, nothing
from regrasp.planner.hand import Hand
from regrasp.planner.outcome import Failure
from regrasp.planner.path import Path
from regrasp.planner.reserve import Margins
from regrasp.planner.scan import Scan
from regrasp.planner.terms import Terms

Array = NDArray[np.float64]
ROUNDS = 24  # choices that are followed along the whole way, until one lasts
MORE = 3  # times as many restarts where agents have few joints: most contacts leave their reach on the way


@dataclass(frozen=True)
class Stance:
    """A grasp that was found, and the candidates of the scan on which its agents stand (k,), OUT where they are off.

    kept: the least part of the path along which one of its contacts can be kept.
    """

    grasp: Grasp
    candidates: NDArray[np.int64]
    kept: float


@dataclass(frozen=True)
class GraspSearch:
    """How a start grasp is found: random choices among the candidates, each improved agent by agent.

    restarts: choices improved; tries: made at most to find so many that hold. friction_use: part of μ the start grasp may
    use, so that the motion has some left.
    """

    restarts: int = 6
    tries: int = 20_000
    friction_use: float = 0.6


def find_grasp(
    hand: Hand, path: Path, scan: Scan, terms: Terms, off: tuple[int, ...], names: tuple[str, ...],
    settings: GraspSearch, rng: np.random.Generator, holding: Grasp | None = None, stride: int = 1,
) -> tuple[Stance, ...] | Failure:  # fmt: skip
    """Grasps on candidates of the scan, what each restart leads to, the one of the least cost first.

    All agents hold that are not off; where supports carry the object, as many as it costs least. holding: the grasp at hand,
    in whose way nobody may stand; else those who are off are at rest. stride: as in `look_over`.
    """
    k, count, geoms = len(hand.tip_geom), len(scan.p_O), int(np.max(np.diff(hand.geom_start)))
    agents = np.array([i for i in range(k) if i not in off], np.int64)
    carried = path.support_mode.shape[1] > 0
    R_WB, p_WB = bodies_along(hand, path)
    ahead = nothing_ahead(len(agents), count, geoms)
    for a, i in enumerate(agents):
        reached = look_over(hand, path, scan, R_WB, p_WB, i, terms, a, ahead, stride)
        if not reached and not carried:
            return Failure(
                "reach", "start", names[i], "reaches no point of the object that is clear of everything",
                "move the object nearer to its base, or list the agent in start.off",
            )  # fmt: skip
    legal = [np.append(np.flatnonzero(row >= 0.0), [OUT] if carried else []).astype(np.int64) for row in ahead.kept]
    if all(len(free) == 1 for free in legal) and carried:
        return Failure(
            "reach", "start", "", "no agent reaches a point of the object that is clear of everything",
            "agents nearer to the object",
        )  # fmt: skip
    rest_R, rest_p = np.zeros((k, geoms, 3, 3)), np.zeros((k, geoms, 3))
    for i in range(k):
        first, last = hand.chains.start[i], hand.chains.start[i + 1]
        R_WL, p_WL = np.empty((last - first + 1, 3, 3)), np.empty((last - first + 1, 3))
        forward(hand.chains, i, (hand.home if holding is None else holding.q)[first:last], R_WL, p_WL)
        place_agent(
            hand, i, path.R_WP[hand.base[i], 0, 0], path.p_WP[hand.base[i], 0, 0], R_WL, p_WL, rest_R[i], rest_p[i]
        )
    own = object_row(hand)
    for i in off:
        if holding is not None and holding.holds[i]:
            continue
        if (
            hits(hand, i, k, rest_R[i], rest_p[i], R_WB[0], p_WB[0], 0.0)
            or hits(hand, i, k + 1, rest_R[i], rest_p[i], R_WB[0, own:], p_WB[0, own:], 0.0)
            or tip_hits(hand, i, rest_R[i], rest_p[i], R_WB[0, own:], p_WB[0, own:], 0.0)
        ):
            return Failure("collision", "start", names[i], "its rest posture collides", "another home for the agent")
    wandering = any(wanders(hand, i) for i in agents)
    most = max(terms.margins.friction, 1.0 - settings.friction_use)
    margins = Margins(most, terms.margins.grip, terms.margins.disturbance, terms.margins.slide)
    fixed, w = (hand, path, terms, agents, rest_R, rest_p), new_weighing(hand, path)
    u = rng.random((settings.tries, len(agents)))
    drawn_from = [longest(row, free) if wandering else free for row, free in zip(ahead.kept, legal, strict=True)]
    restarts = settings.restarts * (MORE if wandering else 1)
    found = choices(fixed, margins, ahead, w, drawn_from, u, restarts)
    best = sorted(found, key=lambda each: found[each])
    if not (wandering or carried):
        safe = lasting_choice(fixed, scan, margins, ahead, w, legal, u, best)
        best = best if safe is None else [safe, *(choice for choice in best if choice != safe)]
    if not best:
        return Failure(
            "equilibrium", "start", "", "no grasp within reach holds the object",
            "more friction, a larger max_force, a lighter object, or another agent",
        )  # fmt: skip
    return tuple(stance_of(hand, path, scan, agents, choice, ahead.kept) for choice in best)


def lasting_choice(
    fixed: Fixed, scan: Scan, margins: Margins, ahead: Ahead, w: Weighing, legal: list[NDArray[np.int64]], u: Array,
    known: list[Choice],
) -> Choice | None:  # fmt: skip
    """Candidates in the air on which all agents can stay along the whole path: the first known ones, else some found soon.

    Every look ahead finds them lasting; which of them are not, between the looks, is seen by following the choice's contacts,
    and is written to ahead.kept.
    """
    hand, path, terms, agents, _, _ = fixed

    def lasts(choice: Choice) -> bool:
        lost, held = followed(hand, path, scan, terms, stance_of(hand, path, scan, agents, choice, ahead.kept).grasp)
        for a, i in enumerate(agents.tolist()):
            ahead.kept[a, choice[a]] = lost.get(i, ahead.kept[a, choice[a]])
        return held and not lost

    for choice in known:
        if all(ahead.kept[a, c] >= 1.0 for a, c in enumerate(choice)) and lasts(choice):
            return choice
    for row in range(ROUNDS):
        sure = replace(ahead, kept=np.where(ahead.kept >= 1.0, 1.0, -1.0))
        among = [free[kept[free] >= 0.0] for kept, free in zip(sure.kept, legal, strict=True)]
        found = choices(fixed, margins, sure, w, among, u[row::ROUNDS], 1) if all(map(len, among)) else {}
        if not found:
            return None
        for choice in found:
            if lasts(choice):
                return choice
    return None


def followed(hand: Hand, path: Path, scan: Scan, terms: Terms, grasp: Grasp) -> tuple[dict[int, float], bool]:
    """After which part of the path agents that keep their contacts lose them, or touch a static body or the object.

    And whether all else holds: forces, and the agents' distances from each other. Looked at at the ends of all intervals, of
    which the looks of a scan pass over many.
    """
    n = len(path.R_WO)
    problem = ContactMotions(hand, path, scan, terms, grasp, continued(nothing(grasp), n))
    found, now = problem.found, problem.current
    failed = (found.lost[now.at[1:]] != 0) | (found.own[now.at[1:]] != 0)
    lost = {int(i): float(np.argmax(failed[:, i])) / n for i in np.flatnonzero(failed.any(axis=0) & (grasp.holds == 1))}
    return lost, not (np.any(now.e) or np.any(now.touch))


def stance_of(hand: Hand, path: Path, scan: Scan, agents: NDArray[np.int64], choice: Choice, kept: Array) -> Stance:
    """The grasp at the path's start with agent agents[a] on candidate choice[a]; kept: as in `Ahead`."""
    contacts, candidates = {}, np.full(len(hand.tip_geom), OUT)
    for i, c in zip(agents.tolist(), choice, strict=True):
        n_a = hand.chains.start[i + 1] - hand.chains.start[i]
        if c != OUT:
            candidates[i], row = c, scan.row[i, 0, c]
            contacts[i] = (scan.q[row, :n_a].copy(), scan.p[row].copy(), scan.n[row].copy())
    least = min(kept[a, c] for a, c in enumerate(choice) if c != OUT)
    return Stance(build_grasp(hand, path, contacts), candidates, float(least))
