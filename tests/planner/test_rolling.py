"""Fingers of four joints keep a contact by rolling: within their joints' limits, and as far as the scan says they can."""

from collections.abc import Iterator

import numpy as np
from arcs import Arc, arc

from regrasp.kernels.surfaces import tangents
from regrasp.planner.configurations import bodies_along
from regrasp.planner.follow import short_step
from regrasp.planner.grasp import build_grasp
from regrasp.planner.legs import roll
from regrasp.planner.motions import ROLL_MINUS_Y, STAY
from regrasp.planner.rolling import ROOM, cramped, roll_within
from regrasp.planner.scan import LOOKS, Scan, candidate_free, stay_on, touch
from regrasp.planner.trace import trace_contact


def stands(a: Arc, i: int) -> Iterator[tuple[Scan, int]]:
    """The candidates on which agent i can stand at the start of the arc."""
    scan = a.scan()
    R_WB, p_WB = bodies_along(a.hand, a.path)
    for c in range(len(scan.p_O)):
        if candidate_free(a.hand, a.path, scan, R_WB[0], p_WB[0], 0, i, c, a.terms.clearance):
            yield scan, c


def state(a: Arc, scan: Scan, i: int, c: int) -> tuple[np.ndarray, ...]:
    """p_OC, p_TC, R_OT, q of agent i on the candidate, R_WL, p_WL for its links."""
    p_TC, R_OT, n_a = np.empty(3), np.empty((3, 3)), len(a.hand.home[a.joints(i)])
    touch(a.hand, a.path, scan, 0, i, c, p_TC, R_OT)
    row = scan.row[i, 0, c]
    return scan.p[row].copy(), p_TC, R_OT, scan.q[row].copy(), np.empty((n_a + 1, 3, 3)), np.empty((n_a + 1, 3))


def test_it_stays_while_there_is_room_and_takes_the_motion_that_leaves_most() -> None:
    a = arc("allegro-cube")
    steps, stayed, rolled = a.path.R_WO.shape[1] - 1.0, 0, 0
    poses = (a.path.R_WO[0, 0], a.path.p_WO[0, 0], a.path.R_WO[1, 0], a.path.p_WO[1, 0])
    for i in range(len(a.task.names)):
        for scan, c in stands(a, i):
            offered = {}
            for code in range(STAY, ROLL_MINUS_Y + 1):
                p_OC, p_TC, R_OT, q, R_WL, p_WL = state(a, scan, i, c)
                x = np.empty(3)
                tangents(scan.n[scan.row[i, 0, c]], x, np.empty(3))
                if short_step(a.hand, *poses, i, a.terms.commands[code], steps, p_OC, p_TC, R_OT, x, q, R_WL, p_WL):
                    offered[code] = (cramped(a.hand, i, q), q)
            p_OC, p_TC, R_OT, q, R_WL, p_WL = state(a, scan, i, c)
            taken = roll_within(a.hand, a.path, a.terms.commands, 0, 1, i, p_OC, p_TC, R_OT, q, R_WL, p_WL)
            if not offered:
                assert taken < 0
                continue
            np.testing.assert_allclose(q, offered[taken][1], atol=1e-12)
            assert offered[taken][0] <= min(value for value, _ in offered.values()) + 1e-12
            if offered.get(STAY, (1.0,))[0] == 0.0:
                assert taken == STAY
                first = a.hand.chains.start[i]
                assert np.all(q - a.hand.chains.lower[first : first + 4] >= ROOM)
            stayed, rolled = stayed + (taken == STAY), rolled + (taken > STAY)
    assert stayed > 10
    assert rolled > 10


def test_a_contact_that_can_be_kept_is_kept_at_every_sample() -> None:
    """What looks ahead found in one step per interval, the samples find too, but for contacts next to a limit."""
    a = arc("allegro-cube")
    n, m = len(a.path.R_WO), a.path.R_WO.shape[1] - 1
    fine = count = 0
    for i in range(len(a.task.names)):
        mine = a.joints(i)
        for scan, c in stands(a, i):
            q, p, n_O = np.zeros((LOOKS + 1, 4)), np.zeros((LOOKS + 1, 3)), np.zeros((LOOKS + 1, 3))
            if stay_on(a.hand, a.path, scan, a.terms.commands, 0, i, c, 1, q, p, n_O) < LOOKS:
                continue
            grasp = build_grasp(a.hand, a.path, {i: (q[0], p[0], n_O[0])})
            V = np.zeros((n, len(a.task.names)), np.int16)
            roll(a.hand, a.path, a.terms.commands, grasp, V)
            rows = [np.zeros((m + 1, 3)) for _ in range(4)]
            (p_OC, p_TC, x_O, normal), R_OT, joints = rows, np.zeros((m + 1, 3, 3)), np.zeros((m + 1, 4))
            p_OC[-1], p_TC[-1], R_OT[-1], joints[-1] = p[0], grasp.p_TC[i], grasp.R_OT[i], q[0]
            kept = True
            for j in range(n):
                for row in (p_OC, p_TC, R_OT, joints):
                    row[0] = row[-1]
                command = a.terms.commands[V[j, i]]
                kept = kept and trace_contact(a.hand, a.path, command, j, i, p_OC, p_TC, R_OT, x_O, joints, normal)
            count += 1
            if kept:
                fine += 1
                assert np.linalg.norm(p_OC[-1] - p[-1]) < 5e-4
                assert np.all(joints >= a.hand.chains.lower[mine] - 1e-9)
                assert np.all(joints <= a.hand.chains.upper[mine] + 1e-9)
    assert count > 20
    assert fine >= 0.9 * count


def test_steps_of_more_intervals_lead_where_steps_of_one_do() -> None:
    """A first look at contacts may take them: they keep hardly any that single intervals lose, lose few that those keep, and
    end near by."""
    a = arc("allegro-ellipsoid")
    apart, lost, gained = [], 0, 0
    for i in range(len(a.task.names)):
        for scan, c in stands(a, i):
            ends, kept = [], []
            for stride in (1, 3):
                q, p, n_O = np.zeros((LOOKS + 1, 4)), np.zeros((LOOKS + 1, 3)), np.zeros((LOOKS + 1, 3))
                kept.append(stay_on(a.hand, a.path, scan, a.terms.commands, 0, i, c, stride, q, p, n_O) == LOOKS)
                ends.append(p[-1])
            if all(kept):
                apart.append(float(np.linalg.norm(ends[1] - ends[0])))
            lost, gained = lost + (kept[0] and not kept[1]), gained + (kept[1] and not kept[0])
    assert len(apart) > 100
    assert np.median(apart) < 3e-4
    assert lost < 0.2 * len(apart)
    assert gained < 0.03 * len(apart)
