"""What a page is told of a plan: the numbers are the plan's, and what its JavaScript works out from them is true."""

import json
import math
import struct
import zlib
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from regrasp.plan import RELOCATE
from regrasp.scene.load import load
from regrasp.scene.world import build, from_plan
from regrasp.verify.execution import Execution
from regrasp.verify.findings import Certificate, Finding
from regrasp.view.bodies import bodies, poses
from regrasp.view.frames import Instant, put
from regrasp.view.margins import friction_margin, joint_margin
from regrasp.view.sketch import rest
from regrasp.view.story import executed, judged, pack, tell


def unpack(packed: bytes) -> tuple[dict, dict]:
    """Header and arrays, read as the format says."""
    content = zlib.decompress(packed)
    (length,) = struct.unpack_from("<I", content)
    header = json.loads(content[4 : 4 + length])
    arrays = {}
    for name, entry in header["arrays"].items():
        assert entry["at"] % 4 == 0
        count = math.prod(entry["shape"])
        arrays[name] = np.frombuffer(content, entry["type"], count, 4 + length + entry["at"]).reshape(entry["shape"])
    return header, arrays


def test_what_is_packed_comes_out_again(home_plan):
    plan = home_plan("fig3-puma3")
    story = judged(tell(plan), Certificate((Finding("x", "y", math.inf, 1.0, "", 2, None, "finger1"),)))
    header, arrays = unpack(pack(story))
    assert header["certificate"]["findings"][0]["value"] is None
    assert arrays.keys() == story.arrays.keys()
    for name, array in arrays.items():
        np.testing.assert_array_equal(array, story.arrays[name])
    np.testing.assert_array_equal(arrays["V"], plan.V)
    np.testing.assert_allclose(arrays["force"], plan.force_W, rtol=1e-6)


def test_every_visible_geom_of_the_model_is_drawn_where_it_is(home_plan):
    plan = home_plan("puma4-obstacles")
    world = from_plan(plan.scene, plan.xml, plan.assets)
    header, arrays = unpack(pack(tell(plan)))
    shapes = [shape for shape in header["shapes"] if not shape["shell"]]
    assert len(shapes) == world.model.ngeom
    data, R = mujoco.MjData(world.model), np.empty(9)
    for instant in (Instant(0, 0), Instant(3, 2)):
        put(world, plan, instant, data)
        row = arrays["pose"][instant.interval * plan.time.shape[1] + instant.sample]
        drawn = []
        for shape in shapes:
            p = np.array(shape["pose"][:3])
            if shape["body"] >= 0:
                mujoco.mju_quat2Mat(R, row[shape["body"], 3:].astype(float))
                p = row[shape["body"], :3] + R.reshape(3, 3) @ p
            drawn.append(p)
        np.testing.assert_allclose(drawn, data.geom_xpos, atol=2e-6)


def test_a_body_made_to_be_seen_is_drawn_and_what_stands_for_it_is_a_shell():
    """The claw's links are meshes: fingers end in a mesh with a ball in it; what planning keeps clear encloses them."""
    world = build(load("examples/claw.yaml"))
    drawn = bodies(world)
    kinds = {
        shell: {shape.kind for shape in drawn.shapes if shape.agent == 0 and shape.shell == shell}
        for shell in (False, True)
    }
    assert kinds[False] == {"mesh", "sphere"}
    assert kinds[True] - {"mesh"}
    assert sum(shape.tip for shape in drawn.shapes) == len(world.agents)
    for shape in drawn.shapes:
        assert (shape.kind == "mesh") == (shape.mesh >= 0)
        assert shape.mesh < len(drawn.meshes)
    for mesh in drawn.meshes:
        assert mesh.faces.max() < len(mesh.vertices)


def test_every_joint_of_a_plan_is_some_limb_s():
    """Four fingers on an arm: the arm's joints come after theirs."""
    plan = rest(build(load("arm-hand-carry")))
    header = tell(plan).header
    limbs = [*header["agents"], *header["arms"]]
    assert [limb["first"] for limb in limbs] == np.cumsum([0, *(len(limb["slides"]) for limb in limbs[:-1])]).tolist()
    assert sum(len(limb["slides"]) for limb in limbs) == len(plan.joint_names)
    assert [agent["arm"] for agent in header["agents"]] == [0, 0, 0, 0]


def test_margins_are_nought_on_the_cone_and_at_a_limit(home_plan):
    plan = home_plan("fig3-puma3")
    world = from_plan(plan.scene, plan.xml, plan.assets)
    mu = world.agents[0].friction
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, plan.object_quaternion[0, 0])
    n = R.reshape(3, 3) @ plan.n_O[0, 0, 0]
    across = np.cross(n, [0.3, 0.5, 0.7])
    across /= np.linalg.norm(across)
    force = plan.force_W.copy()
    for part, margin in ((0.0, 1.0), (0.5, 0.5), (1.0, 0.0), (1.5, -0.5)):
        force[0, 0, 0] = 2.0 * (-n + part * mu * across)
        found = friction_margin(replace(plan, force_W=force), world)
        assert found[0, 0, 0] == pytest.approx(margin, abs=1e-9)
    assert np.isnan(found[2, :, 0]).all()  # it relocates
    joints = plan.joints.copy()
    middle = (world.agents[0].lower + world.agents[0].upper) / 2
    first = slice(0, len(middle))
    joints[0, 0, first] = middle
    joints[0, 1, first] = middle
    joints[0, 1, 2] = world.agents[0].upper[2]
    found = joint_margin(replace(plan, joints=joints), world)
    assert found[0, 0, 0] == pytest.approx(1.0)
    assert found[0, 1, 0] == pytest.approx(0.0, abs=1e-12)


def test_an_execution_is_told_beside_the_plan(home_plan):
    plan = home_plan("fig3-puma3")
    world = from_plan(plan.scene, plan.xml, plan.assets)
    S, k = 4000, len(world.agents)
    qpos = np.tile(world.start, (S, 1))
    qpos[:, world.object_qpos] += np.linspace(0.0, 0.1, S)
    error = np.zeros((S, 6))
    error[:, 0], error[:, 5] = 0.003, 0.004
    run = Execution(
        np.linspace(0.0, 5.0, S), np.zeros(S, int), qpos, error, np.ones((S, k, 3)), np.zeros((S, k, 3)),
        np.ones((S, k), bool), np.zeros((S, k)), np.zeros((S, k), bool), (), None, 5.0, 1.0,
    )  # fmt: skip
    story = executed(tell(plan), plan, run)
    times, pose = story.arrays["run_time"], story.arrays["run_pose"]
    assert len(times) == len(pose) <= 1500
    assert (times[0], times[-1]) == (0.0, 5.0)
    thing = story.header["object"]
    np.testing.assert_allclose(pose[-1, thing, 0] - pose[0, thing, 0], 0.1, atol=1e-6)
    np.testing.assert_allclose(story.arrays["run_off"], [[0.003, 0.004]] * len(times), atol=1e-8)


def test_the_relocation_s_poses_are_the_joints_own(home_plan):
    plan = home_plan("fig3-puma3")
    assert plan.V[2, 0] == RELOCATE
    world = from_plan(plan.scene, plan.xml, plan.assets)
    ids = bodies(world).ids
    data = mujoco.MjData(world.model)
    put(world, plan, Instant(2, 1), data)
    np.testing.assert_allclose(poses(world, ids, [data.qpos])[0, :, :3], data.xpos[ids], atol=1e-6)
