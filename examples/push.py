"""An object is pushed off its path in mid-plan, 20 mm and 15°, and still reaches its goal: the plan is planned again.

    python examples/push.py              # or with seeds of the plan: python examples/push.py 1 2 3

Everything runs in physics: the object is free, only a wrench on it pushes. The fingers give way to the push; meanwhile
`Replanner.step` plans from the measured pose and joints, leg after leg. An answer counts LATENCY later, if the object is
still there. Beside that, the same push with the plan alone.
"""

import math
import sys
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from regrasp.control.controller import Controller
from regrasp.control.feedback import displacement
from regrasp.control.impedance import gains
from regrasp.control.reference import reference, taken_over
from regrasp.control.yielding import beyond
from regrasp.plan import Plan
from regrasp.planner.method import plan_scene
from regrasp.planner.replan import Answer, Replanner
from regrasp.planner.task import Settings
from regrasp.scene.load import load
from regrasp.scene.world import from_plan
from regrasp.settings import read
from regrasp.verify.physics import PERIOD, Physics, nominal
from regrasp.verify.replay import control_of

Array = NDArray[np.float64]

LOOK = 0.02
"""s between two measurements of the object."""
LOST = 2.0
"""Radii of the object off its path, from which on it counts as dropped."""
SLOW = 0.04
"""m/s, its turn counted with its radius: an object that moves faster is not worth planning for."""
LATENCY = 0.1
"""s that pass until a step's answer is there."""
PATIENCE = 60
"""Steps without a plan, one after the other, until all is given up."""


@dataclass(frozen=True)
class Push:
    """A wrench that drives the object along a smooth way to `shift` (3,), m, and `turn` (3,), rad, off where it was.

    begin: s, on the plan's clock. seconds: that it takes. It lets go as soon as the object is that far off.
    """

    begin: float
    shift: Array
    turn: Array
    seconds: float = 1.5
    stiffness: float = 2000.0
    torsion: float = 1.5

    def wrench(self, since: float, off: Array, rate: Array) -> Array:
        """Force and torque (6,) on the object `since` s after the beginning, moved by off (6,) since then at rate (6,)."""
        u = min(1.0, since / self.seconds)
        # The fingers pull back: it goes on beyond the end, as far as it takes.
        far = 1.15 * (3 * u * u - 2 * u**3) + 0.4 * max(0.0, since / self.seconds - 1.0)
        wanted = far * np.concatenate([self.shift, self.turn])
        k = np.repeat([self.stiffness, self.torsion], 3)
        return k * (wanted - off) - 0.005 * k * rate

    def is_done(self, off: Array) -> bool:
        """Whether the object is as far off as it should be."""
        far, near = np.linalg.norm(off.reshape(2, 3), axis=1), np.linalg.norm([self.shift, self.turn], axis=1)
        return bool(np.all(far >= near))


@dataclass(frozen=True)
class Run:
    """How it ended. pushed: m and rad off where it was as the push lets go; answers: of the replanner, those that planned or
    failed to; final: m and rad off the goal; dropped: whether the object was lost."""

    pushed: tuple[float, float]
    answers: tuple[Answer, ...]
    final: tuple[float, float]
    dropped: bool

    @property
    def reached(self) -> bool:
        """Whether the object is at its goal, 5 mm and 5°."""
        return self.final[0] < 5e-3 and self.final[1] < math.radians(5.0)


def size(error: Array) -> tuple[float, float]:
    """m and rad of a displacement (6,)."""
    return float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))


def run(plan: Plan, push: Push, replanner: Replanner | None) -> Run:
    """The plan in physics with a push on its way, planned again if there is a replanner."""
    world, control = from_plan(plan.scene, plan.xml, plan.assets), control_of(plan)
    drives = gains(world, plan.joints[0, 0], control.impedance, PERIOD)
    table = reference(plan, world, PERIOD, control.phases)
    physics = Physics(world, nominal(world), drives)
    physics.place(table.q[0])
    controller = Controller(world, table, control, physics.drives.gains.K)
    body, dof = world.object_body, physics.model.joint("object").dofadr[0]
    radius = float(physics.model.geom_rbound[world.object_geoms].max())
    every, row, tick, due = round(LOOK / PERIOD), 0, 0, 0
    begun, let_go, gives_way, dropped, complete = math.inf, False, False, False, True
    before = at_push = (physics.p_WO, physics.R_WO)
    pushed, answers, failed = (0.0, 0.0), [], 0
    at_hand, pending = plan, None
    while row < len(table) and failed < PATIENCE:
        if row == table.start:
            physics.release()
        command = controller.command(row, physics.q, physics.qd)
        waits = gives_way or (not complete and row >= table.end)
        if tick % every == 0:
            seen = physics.p_WO, physics.R_WO
            error = displacement(table.p_WO[row], table.R_WO[row], *seen)
            far = row >= table.start and bool(np.any(beyond(control.leash, error)))
            gives_way = replanner is not None and (gives_way or far)
            dropped = size(error)[0] > LOST * radius or size(error)[1] > 2.0
            if dropped:
                break
            step = size(displacement(*before, *seen))
            slow, before = step[0] + radius * step[1] < SLOW * LOOK, seen
            mine = controller
            if pending is not None and tick >= due:
                answer, pending = pending, None
                begin = answer.plan.object_position[0, 0], rotation(answer.plan.object_quaternion[0, 0])
                if answer.plan is not at_hand and not np.any(beyond(control.leash, displacement(*begin, *seen))):
                    at_hand, complete = answer.plan, answer.complete
                    table = taken_over(at_hand, PERIOD, control.phases, controller.forces(row)[0])
                    controller, gives_way, row = Controller(world, table, control, physics.drives.gains.K), False, 0
                elif answer.plan is at_hand and not answer.failure:
                    controller, gives_way = Controller(world, table, control, physics.drives.gains.K), False
            elif replanner is not None and waits and slow and pending is None:
                pending = replanner.step(table.time(row), (physics.R_WO, physics.p_WO), physics.q)
                answers.append(pending)
                due, failed = tick + round(LATENCY / PERIOD), failed + 1 if pending.failure else 0
            if controller is not mine:
                pass  # it begins with a command
            elif gives_way:
                controller.give_way(row, seen)
            else:
                controller.update(row, seen)
        now = table.time(row)
        if now >= push.begin and begun == math.inf:
            begun, at_push = tick, (physics.p_WO, physics.R_WO)
        if begun < math.inf and not let_go:
            off = displacement(*at_push, physics.p_WO, physics.R_WO)
            rate = np.concatenate(
                [physics.data.qvel[dof : dof + 3], physics.R_WO @ physics.data.qvel[dof + 3 : dof + 6]]
            )
            let_go = push.is_done(off) or (tick - begun) * PERIOD > 3.0 * push.seconds
            pushed = size(off)
            physics.data.xfrc_applied[body] = 0.0 if let_go else push.wrench((tick - begun) * PERIOD, off, rate)
        physics.step(command)
        tick += 1
        row += not waits
    goal = world.scene.goal.pose
    final = size(displacement(goal.p, goal.R, physics.p_WO, physics.R_WO))
    return Run(pushed, tuple(answers), final, dropped)


def rotation(quaternion: Array) -> Array:
    """R (3, 3) of a quaternion w x y z."""
    return Rotation.from_quat(quaternion, scalar_first=True).as_matrix()


def planned(name: str, seed: int) -> Plan:
    """A plan of a scene."""
    scene = load(name)
    outcome = plan_scene(scene, seed, read(Settings, scene.planner))
    if outcome.plan is None:
        raise SystemExit(str(outcome.failure))
    return outcome.plan


def upwards(plan: Plan) -> Push:
    """20 mm, mostly up, and 15°, in the first third of a plan."""
    shift, turn = np.array([0.2, -0.2, 1.0]), np.array([0.15, -0.8, 0.55])
    return Push(
        0.3 * float(plan.time[-1, -1]),
        0.02 * shift / np.linalg.norm(shift),
        math.radians(15.0) * turn / np.linalg.norm(turn),
    )


def told(answer: Answer) -> str:
    """What a step said, in words."""
    if not answer.new:
        return str(answer.failure or "on its path")
    whole = "the goal" if answer.complete else "a subgoal"
    return f"a plan of {answer.plan.summary()['duration']:.1f} s to {whole}"


def both(seed: int) -> list[bool]:
    """Both runs of a plan, in words; whether they reach the goal."""
    reached = []
    plan = planned("fig4-relocation", seed)
    push = upwards(plan)
    for words, replanner in (("the plan alone", None), ("planned again", Replanner(plan))):
        found = run(plan, push, replanner)
        print(f"{words}: pushed {1e3 * found.pushed[0]:.1f} mm and {math.degrees(found.pushed[1]):.1f}° off")
        for answer in found.answers:
            off = f"{1e3 * answer.off[0]:.1f} mm and {math.degrees(answer.off[1]):.1f}° off its path"
            print(f"  step(): {off}, {1e3 * answer.seconds:.0f} ms: {told(answer)}")
        lost = ", the object was dropped" if found.dropped else ""
        print(f"  at the end {1e3 * found.final[0]:.1f} mm and {math.degrees(found.final[1]):.1f}° off the goal{lost}")
        reached.append(found.reached)
    return reached


def main() -> None:
    """Both runs of each plan."""
    seeds = [int(word) for word in sys.argv[1:]] or [2]
    alone, again = np.sum([both(seed) for seed in seeds], axis=0)
    print(f"at the goal: {alone} of {len(seeds)} alone, {again} planned again")


if __name__ == "__main__":
    main()
