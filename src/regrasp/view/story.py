"""What a page tells of a plan, in numbers that are ready to be drawn: bodies, contacts, forces, V, margins, findings.

One value feeds the live page and the file alike. Packed, it is a JSON header and little-endian arrays, see `pack`.
"""

import json
import struct
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from regrasp.plan import MOTIONS, Plan
from regrasp.scene.world import World, from_plan
from regrasp.view import strip
from regrasp.view.bodies import Bodies, bodies, poses
from regrasp.view.frames import choose
from regrasp.view.ink import AGENT_FORCE, AGENTS, SUPPORT_FORCE
from regrasp.view.margins import friction_margin, joint_margin
from regrasp.view.viewpoint import LONGEST, object_radius, outlook

if TYPE_CHECKING:
    from regrasp.verify.execution import Execution
    from regrasp.verify.findings import Certificate

Array = NDArray[np.float64]

COLOURS = {"stay": strip.STAY, "roll": strip.ROLL, "slide": strip.SLIP, "relocate": strip.MOVE, "off": strip.FREE,
           "force": AGENT_FORCE, "support": SUPPORT_FORCE}  # fmt: skip
"""Of contact motions and of forces."""
RECORDS = 1500
"""Records of an execution that a page has at most."""


@dataclass(frozen=True)
class Story:
    """header: JSON values; arrays: by name, with N intervals of M samples, k agents, P support slots, B moving bodies.

    time (N, M), pose (N M, B, 7), p_O, n_O, x_O, force (N, M, k, 3), support_p_O, support_n_W, support_force (N, M, P, 3),
    V (N, k), support_mode (N, P), segment (N,), joints (N, M, nq), friction_margin, joint_margin (N, M, k), energy,
    energy_segment (L,); of an execution run_time (S,), run_pose (S, B, 7), run_force (S, k, 3), run_off (S, 2).
    """

    header: Mapping[str, Any]
    arrays: Mapping[str, NDArray[np.generic]]


def tell(plan: Plan) -> Story:
    """The story of a plan. Raises InputError if its model cannot be built."""
    world = from_plan(plan.scene, plan.xml, plan.assets)
    stage = bodies(world)
    qpos = np.tile(world.start, (plan.time.size, 1))
    qpos[:, world.joint_qpos] = plan.joints.reshape(len(qpos), -1)
    at = world.object_qpos
    qpos[:, at : at + 3] = plan.object_position.reshape(-1, 3)
    qpos[:, at + 3 : at + 7] = plan.object_quaternion.reshape(-1, 4)
    numbers = {
        "time": plan.time - plan.time[0, 0],
        "pose": poses(world, stage.ids, qpos),
        "p_O": plan.p_OC_O,
        "n_O": plan.n_O,
        "x_O": plan.x_O,
        "force": plan.force_W,
        "support_p_O": plan.support_p_O,
        "support_n_W": plan.support_n_W,
        "support_force": plan.support_force_W,
        "joints": plan.joints,
        "friction_margin": friction_margin(plan, world),
        "joint_margin": joint_margin(plan, world),
        "energy": plan.energy,
        "twist": plan.twist,
    }
    whole = {"V": plan.V, "support_mode": plan.support_mode}
    counts = {"segment": plan.segment, "energy_segment": plan.energy_segment}
    arrays: dict[str, NDArray[np.generic]] = {name: array.astype(np.float32) for name, array in numbers.items()}
    arrays |= {name: array.astype(np.int8) for name, array in whole.items()}
    arrays |= {name: array.astype(np.int32) for name, array in counts.items()}
    for i, mesh in enumerate(stage.meshes):
        arrays |= {f"vertices{i}": mesh.vertices, f"faces{i}": mesh.faces, f"normals{i}": mesh.normals}
    return Story(_header(plan, world, stage, qpos), arrays)


def judged(story: Story, certificate: "Certificate") -> Story:
    """The story with what `check` found."""
    return replace(story, header={**story.header, "certificate": certificate.to_dict()})


def executed(story: Story, plan: Plan, run: "Execution") -> Story:
    """The story with what happened in physics beside what was planned."""
    world = from_plan(plan.scene, plan.xml, plan.assets)
    rows = np.unique(np.linspace(0, len(run.time) - 1, min(RECORDS, len(run.time))).astype(int))
    arrays = {
        "run_time": (run.time[rows] - plan.time[0, 0]).astype(np.float32),
        "run_pose": poses(world, bodies(world).ids, run.qpos[rows]),
        "run_force": run.force_W[rows].astype(np.float32),
        "run_off": run.off[rows].astype(np.float32),
    }
    said = "" if run.trouble is None else f"{run.trouble.what}: {run.trouble.body}, t = {run.trouble.time:.2f} s"
    return Story({**story.header, "run": {"trouble": said}}, {**story.arrays, **arrays})


def pack(story: Story) -> bytes:
    """The story as bytes: the header's length (4), the header with each array's dtype, shape and place, the arrays.

    Everything is compressed together (zlib); arrays begin at multiples of 4 bytes.
    """
    body, index = bytearray(), {}
    for name, array in story.arrays.items():
        plain = np.ascontiguousarray(array)
        index[name] = {"type": plain.dtype.name, "shape": plain.shape, "at": len(body)}
        body += plain.tobytes() + bytes(-plain.nbytes % 4)
    head = json.dumps({**story.header, "arrays": index}, allow_nan=False).encode()
    head += b" " * (-len(head) % 4)
    return zlib.compress(struct.pack("<I", len(head)) + head + bytes(body), 9)


def _header(plan: Plan, world: World, stage: Bodies, qpos: Array) -> dict[str, Any]:
    forces = np.concatenate([plan.force_W, plan.support_force_W], axis=2)
    largest = float(np.linalg.norm(forces, axis=-1).max(initial=0.0))
    rows = [instant.interval * plan.time.shape[1] + instant.sample for instant in choose(plan, 6)]
    seen = outlook(world, [qpos[row] for row in rows])
    radius, first, limbs = object_radius(world), 0, []
    for limb in world.limbs:
        slides = [bool(world.model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE) for j in limb.joints]
        limbs.append({"name": limb.name, "first": first, "slides": slides})
        first += len(slides)
    agents = [
        {**limb, "colour": AGENTS[i % len(AGENTS)], "mu": agent.friction, "arm": agent.arm}
        for i, (limb, agent) in enumerate(zip(limbs, world.agents, strict=False))
    ]
    mu = dict(zip(world.support_names, world.support_friction.tolist(), strict=True))
    goal = world.scene.goal.pose
    return {
        "name": str(plan.scene.get("name", "")),
        "words": world.scene.description,
        "begin": float(plan.time[0, 0]),
        "remarks": plan.remarks,
        "motions": MOTIONS,
        "colours": COLOURS,
        "agents": agents,
        "arms": limbs[len(agents) :],
        "slots": [{"name": name, "mu": mu[name]} for name in plan.support_names],
        "object": int(np.flatnonzero(stage.ids == world.object_body)[0]),
        "bodies": len(stage.ids),
        "shapes": [asdict(shape) for shape in stage.shapes],
        "meshes": len(stage.meshes),
        "goal": [*map(float, goal.p), *map(float, goal.wxyz)],
        "radius": radius,
        "reach": LONGEST * radius / largest if largest > 0.0 else 0.0,
        "view": {"towards": seen.towards.tolist(), "centre": seen.centre.tolist(), "radius": seen.radius},
        "route": plan.route.tolist(),
        "draft": False,
        "certificate": None,
        "run": None,
    }
