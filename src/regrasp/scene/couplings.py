"""Joints that follow others: what a model's equality constraints say of the chains of its agents."""

from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import mjtEq, mjtObj, mjtWrap
from numpy.typing import NDArray

from regrasp.errors import InputError

Array = NDArray[np.float64]
Ids = NDArray[np.int64]

FOLLOWER = "two joints of one agent's chain, polycoef='a b 0 0 0'"


@dataclass(frozen=True)
class Coupling:
    """n joints, some of which follow another one: q_f = offset + gain · q_m.

    master (n,): which one each follows, itself if it is free; gain, offset (n,): 1 and 0 of a free one.
    """

    master: Ids
    gain: Array
    offset: Array

    @property
    def free(self) -> NDArray[np.bool_]:
        """Which joints follow no other, (n,)."""
        return self.master == np.arange(len(self.master))

    def narrowed(self, lower: Array, upper: Array) -> tuple[Array, Array]:
        """Ranges (n,) of the free joints in which their followers keep theirs; ±inf for followers."""
        ends = np.sort((np.array([lower, upper]) - self.offset) / self.gain, axis=0)
        lower, upper = np.where(self.free, lower, -np.inf), np.where(self.free, upper, np.inf)
        np.maximum.at(lower, self.master, ends[0])
        np.minimum.at(upper, self.master, ends[1])
        return np.where(self.free, lower, -np.inf), np.where(self.free, upper, np.inf)

    def expand(self, q: Array) -> Array:
        """Joint values q (…, n) with those of the followers as their masters ask."""
        return np.asarray(self.offset + self.gain * q[..., self.master])

    @property
    def matrix(self) -> Array:
        """∂q/∂q of the free joints, (n, n_free)."""
        return np.asarray((self.gain[:, None] * (self.master[:, None] == np.arange(len(self.master))))[:, self.free])

    def reduce(self, J: Array) -> Array:
        """Columns or torques J (…, n) of single joints as those of the free ones: a follower's goes to its master, 0 stays."""
        out = np.where(self.free, J, 0.0)
        for i in np.flatnonzero(~self.free):
            out[..., self.master[i]] += self.gain[i] * J[..., i]
        return out


def coupling(model: mujoco.MjModel, joints: Ids) -> Coupling:
    """The coupling of some joints (ids) of a world's model, in their order.

    y − y_0 = a + b (x − x_0), with the values at `qpos0`, is what an equality constraint of two joints asks.
    """
    n = len(joints)
    out = Coupling(np.arange(n), np.ones(n), np.zeros(n))
    at = {int(joint): i for i, joint in enumerate(joints)}
    for e in np.flatnonzero((model.eq_type == int(mjtEq.mjEQ_JOINT)) & (model.eq_active0 != 0)):
        y, x = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
        if y in at and x in at:
            a, b = model.eq_data[e, :2]
            y_0, x_0 = model.qpos0[model.jnt_qposadr[[y, x]]]
            out.master[at[y]], out.gain[at[y]], out.offset[at[y]] = at[x], b, y_0 + a - b * x_0
    while not out.free[out.master].all():  # followers of followers
        for i in np.flatnonzero(~out.free):
            m = out.master[i]
            out.master[i], out.gain[i] = out.master[m], out.gain[i] * out.gain[m]
            out.offset[i] += (out.gain[i] / out.gain[m]) * out.offset[m]
    return out


def settle(robot: mujoco.MjSpec, chains: list[list[mujoco.MjsJoint]]) -> list[str]:
    """Leaves of a robot's equality constraints those by which a joint of an agent follows another one of its own.

    Those of tendons that couple two joints become such. Drops what binds no agent. Returns what was changed, in sentences;
    raises InputError for a constraint that binds an agent in another way.
    """
    said = _of_tendons(robot, chains)
    owner = {joint: i for joint, (i, _) in _places(chains).items()}
    bodies = _bodies(robot, chains)
    masters: dict[str, str] = {}
    for equality in list(robot.equalities):
        ends = {equality.name1, equality.name2}
        couples = equality.type == mjtEq.mjEQ_JOINT
        closes = equality.type in (mjtEq.mjEQ_CONNECT, mjtEq.mjEQ_WELD) and equality.objtype == mjtObj.mjOBJ_BODY
        if not equality.active or (couples and not ends & set(owner)) or (closes and not ends & bodies):
            robot.delete(equality)
            continue
        who = " and ".join(repr(end) for end in (equality.name1, equality.name2) if end)
        if not couples:
            hint = "agents are open chains of hinges and slides; a joint may follow one of its own chain"
            raise InputError("model", f"an equality constraint binds {who}", hint)
        if not equality.name2:
            raise InputError(
                "model",
                f"an equality constraint holds {who} where it is",
                "take the joint out of the file, or its constraint",
            )
        if owner.get(equality.name1) != owner.get(equality.name2):
            raise InputError("model", f"an equality constraint couples {who}, not of one chain", FOLLOWER)
        if np.any(equality.data[2:5] != 0.0):
            raise InputError(
                "model", f"an equality constraint couples {who} by a curve", f"a straight line: {FOLLOWER}"
            )
        if equality.data[1] == 0.0:
            raise InputError("model", f"an equality constraint couples {who} with a ratio of 0", FOLLOWER)
        if equality.name1 in masters:
            raise InputError(
                "model", f"two equality constraints move {equality.name1!r}", "each joint follows one other"
            )
        masters[equality.name1] = equality.name2
    _require_free_masters(masters)
    for actuator in list(robot.actuators):
        if actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT and actuator.target in masters:
            said.append(f"joint {actuator.target!r} follows {masters[actuator.target]!r}: its own drive is left out")
            robot.delete(actuator)
    return said


def _places(chains: list[list[mujoco.MjsJoint]]) -> dict[str, tuple[int, int]]:
    """Joint → (its agent, −1 for one that several share; its place in the chain)."""
    places: dict[str, tuple[int, int]] = {}
    for i, chain in enumerate(chains):
        for at, joint in enumerate(chain):
            places[joint.name] = (i if joint.name not in places else -1, at)
    return places


def _require_free_masters(masters: dict[str, str]) -> None:
    for name in masters:
        seen, at = {name}, name
        while at in masters:
            at = masters[at]
            if at in seen:
                raise InputError("model", f"equality constraints couple {name!r} in a ring", "one of the joints free")
            seen.add(at)


def _bodies(robot: mujoco.MjSpec, chains: list[list[mujoco.MjsJoint]]) -> set[str]:
    """Names of the bodies that agents move."""
    driven = {joint.parent.id for chain in chains for joint in chain}
    moved = set()
    for body in robot.bodies[1:]:
        above = body
        while above.id != 0 and above.id not in driven:
            above = above.parent
        if above.id != 0:
            moved.add(body.name)
    return moved


def _of_tendons(robot: mujoco.MjSpec, chains: list[list[mujoco.MjsJoint]]) -> list[str]:
    """Puts a constraint of two joints in the place of every one of fixed tendons that couples two joints of a chain.

    Σ c_i (q_i − q_i,0) of the first tendon is a + b times that of the second, if there is one. The joint nearer to the tip
    follows.
    """
    order = _places(chains)
    tendons = {tendon.name: tendon for tendon in robot.tendons}
    said, bound = [], set()
    for equality in list(robot.equalities):
        if equality.type != mjtEq.mjEQ_TENDON:
            continue
        name = f"tendon {equality.name1!r}"
        terms: dict[str, float] = {}
        for tendon, sign in ((equality.name1, 1.0), (equality.name2, -float(equality.data[1]))):
            for joint, weight in _weights(tendons[tendon] if tendon else None).items():
                terms[joint] = terms.get(joint, 0.0) + sign * weight
        terms = {joint: weight for joint, weight in terms.items() if weight != 0.0}
        if not equality.active or not set(terms) & set(order):
            robot.delete(equality)
            continue
        if len(terms) != 2 or len({order.get(joint, (-2, 0))[0] for joint in terms}) > 1:
            raise InputError("model", f"an equality constraint of {name} couples {_listed(terms)}", FOLLOWER)
        if np.any(equality.data[(1 if not equality.name2 else 2) : 5] != 0.0):
            raise InputError("model", f"an equality constraint of {name} couples {_listed(terms)} by a curve", FOLLOWER)
        (x, b), (y, c) = sorted(terms.items(), key=lambda term: order[term[0]])
        robot.add_equality(
            type=mjtEq.mjEQ_JOINT, name1=y, name2=x, data=[equality.data[0] / c, -b / c, *[0.0] * 8, 1.0, 0.0]
        )
        bound |= {equality.name1, equality.name2}
        robot.delete(equality)
        said.append(f"{name} makes joint {y!r} follow {x!r}")
    for name, tendon in tendons.items():
        joints = [joint for joint in _weights(tendon) if joint in order]
        if len(joints) > 1 and name not in bound:
            said.append(f"tendon {name!r} is left out: {_listed(joints)} move each by itself in a plan")
    return said


def _weights(tendon: mujoco.MjsTendon | None) -> dict[str, float]:
    """Joint → its coefficient in a fixed tendon; none of a spatial one."""
    return {
        wrap.target.name: float(wrap.coef) for wrap in (tendon.path if tendon else ()) if wrap.type == mjtWrap.mjWRAP_JOINT
    }  # fmt: skip


def _listed(names: Iterable[str]) -> str:
    return ", ".join(repr(name) for name in names)
