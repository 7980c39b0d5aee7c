"""Kernel arrays of a MuJoCo model: MuJoCo's own kinematics are the oracle, on random trees."""

from collections.abc import Iterable

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from regrasp.errors import InputError
from regrasp.kernels import cores
from regrasp.kernels.chains import forward, jacobian
from regrasp.kernels.distances import OBJECT, STATIC
from regrasp.planner.arrays import chains_from, geoms_from
from regrasp.scene.fits import Primitive


def pose(rng: np.random.Generator, size: float) -> str:
    p, quat = rng.normal(size=3) * size, rng.normal(size=4)
    return f'pos="{p[0]} {p[1]} {p[2]}" quat="{quat[0]} {quat[1]} {quat[2]} {quat[3]}"'


def joint(rng: np.random.Generator, name: str) -> str:
    """A hinge or slide with any axis, anchor, reference and limits."""
    kind, ref = rng.choice(["hinge", "slide"], p=[0.7, 0.3]), rng.choice([0.0, rng.normal()])
    axis, anchor = rng.normal(size=3), rng.normal(size=3) * 0.1
    limits = 'range="-2 1.5"' if rng.random() < 0.5 else ""
    return (
        f'<joint name="{name}" type="{kind}" axis="{axis[0]} {axis[1]} {axis[2]}" '
        f'pos="{anchor[0]} {anchor[1]} {anchor[2]}" ref="{ref}" {limits}/>'
    )


def serial_tree(rng: np.random.Generator, name: str) -> str:
    """A serial chain of bodies with zero, one or several joints each and geoms on all; two joints at least."""
    opened, inner, count = "", "", 0
    for b in range(int(rng.integers(4, 8))):
        opened += f"<body {pose(rng, 0.2)}>"
        for _ in range([0, 2, 1, 0][b] if b < 4 else int(rng.integers(0, 3))):
            opened += joint(rng, f"{name}{count}")
            count += 1
        opened += f'<geom name="{name}_link{b}" type="capsule" size="0.01 0.03" {pose(rng, 0.1)}/>'
        inner += "</body>"
    return opened + f'<geom name="{name}_tip" type="sphere" size="0.01" {pose(rng, 0.1)}/>' + inner


def two_agents(seed: int) -> tuple[mujoco.MjModel, list[list[int]], list[int], int]:
    """Two random chains, a free object with a fixed part, a static body: model, joints, tips, object body."""
    rng = np.random.default_rng(seed)
    xml = f"""<mujoco><compiler angle="radian" autolimits="true"/><worldbody>
      <geom name="floor" type="plane" size="1 1 1" {pose(rng, 0.1)}/>
      {serial_tree(rng, "a")}
      <body name="object" {pose(rng, 0.3)}><freejoint/><geom name="core" type="box" size="0.03 0.02 0.01"/>
        <body {pose(rng, 0.1)}><geom name="handle" type="cylinder" size="0.01 0.04" {pose(rng, 0.1)}/></body></body>
      <body {pose(rng, 0.3)}><geom name="post" type="ellipsoid" size="0.1 0.2 0.3" {pose(rng, 0.1)}/></body>
      {serial_tree(rng, "b")}
    </worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    names = [model.joint(j).name for j in range(model.njnt)]
    joints = [[j for j, n in enumerate(names) if n.startswith(a)] for a in "ab"]
    return model, joints, [model.geom("a_tip").id, model.geom("b_tip").id], model.body("object").id


def whole(geoms: Iterable[int]) -> list[tuple[int, int]]:
    """The parts of geoms for none of which other shapes stand."""
    return [(g, 0) for g in geoms]


def frames(chains, a: int, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    R_WL, p_WL = np.full((len(q) + 1, 3, 3), np.nan), np.full((len(q) + 1, 3), np.nan)
    forward(chains, a, q, R_WL, p_WL)
    return R_WL, p_WL


@pytest.mark.parametrize("seed", range(12))
def test_forward_and_jacobian_are_mujocos(seed: int) -> None:
    model, joints, tips, _ = two_agents(seed)
    chains = chains_from(model, joints, tips)
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    data.qpos[:] = rng.uniform(-3, 3, model.nq)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    for a in range(2):
        R_WL, p_WL = frames(chains, a, data.qpos[model.jnt_qposadr[joints[a]]])
        np.testing.assert_allclose(R_WL[-1], data.geom_xmat[tips[a]].reshape(3, 3), atol=1e-12)
        np.testing.assert_allclose(p_WL[-1], data.geom_xpos[tips[a]], atol=1e-12)
        turning = model.jnt_type[joints[a]] == mujoco.mjtJoint.mjJNT_HINGE  # a slide takes its frame along
        np.testing.assert_allclose(p_WL[:-1][turning], data.xanchor[joints[a]][turning], atol=1e-12)
        point, J = rng.normal(size=3), np.full((6, len(joints[a])), np.nan)
        jacobian(chains, a, R_WL, p_WL, point, J)
        Jp, Jr = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, Jp, Jr, point, model.geom_bodyid[tips[a]])
        np.testing.assert_allclose(J, np.vstack([Jp, Jr])[:, model.jnt_dofadr[joints[a]]], atol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_every_geom_stands_where_mujoco_has_it(seed: int) -> None:
    model, joints, tips, body = two_agents(seed)
    chains, geoms = chains_from(model, joints, tips), geoms_from(model, whole(range(model.ngeom)), joints, body, {})
    data = mujoco.MjData(model)
    data.qpos[:] = np.random.default_rng(seed).uniform(-2, 2, model.nq)
    mujoco.mj_kinematics(model, data)
    links = [frames(chains, a, data.qpos[model.jnt_qposadr[joints[a]]]) for a in range(2)]
    for g in range(model.ngeom):
        if geoms.agent[g] >= 0:
            R_WL, p_WL = (x[geoms.link[g]] for x in links[geoms.agent[g]])
        elif geoms.agent[g] == OBJECT:
            R_WL, p_WL = data.xmat[body].reshape(3, 3), data.xpos[body]
        else:
            R_WL, p_WL = np.eye(3), np.zeros(3)
        R_WG, p_WG = R_WL @ geoms.R_LG[g], R_WL @ geoms.p_LG[g] + p_WL
        np.testing.assert_allclose(R_WG, data.geom_xmat[g].reshape(3, 3), atol=1e-12)
        np.testing.assert_allclose(p_WG, data.geom_xpos[g], atol=1e-12)
    owner = {model.geom(g).name: geoms.agent[g] for g in range(model.ngeom)}
    assert (owner["floor"], owner["post"], owner["core"], owner["handle"]) == (STATIC, STATIC, OBJECT, OBJECT)
    assert (owner["a_tip"], owner["b_tip"], owner["a_link0"]) == (0, 1, STATIC)  # nothing moves the first body


def test_limits_come_in_the_order_of_the_joints() -> None:
    model, joints, tips, _ = two_agents(3)
    chains = chains_from(model, joints[::-1], tips[::-1])
    ids = [*joints[1], *joints[0]]
    assert chains.start.tolist() == [0, len(joints[1]), len(ids)]
    free = model.jnt_limited[ids] == 0
    assert free.any()
    assert not free.all()
    np.testing.assert_array_equal(np.isinf(chains.lower) & np.isinf(chains.upper), free)
    np.testing.assert_array_equal(np.c_[chains.lower, chains.upper][~free], model.jnt_range[ids][~free])


@pytest.mark.parametrize(
    ("type_", "size", "kind", "core", "radius", "bound"),
    [
        ("sphere", "0.3", cores.POINT, [0, 0, 0], 0.3, 0.3),
        ("capsule", "0.1 0.5", cores.SEGMENT, [0, 0, 0.5], 0.1, 0.6),
        ("box", "0.1 0.2 0.2", cores.BOX, [0.1, 0.2, 0.2], 0, 0.3),
        ("cylinder", "0.3 0.4", cores.CYLINDER, [0.3, 0.3, 0.4], 0, 0.5),
        ("ellipsoid", "0.1 0.3 0.2", cores.ELLIPSOID, [0.1, 0.3, 0.2], 0, 0.3),
        ("plane", "1 1 1", cores.PLANE, [0, 0, 0], 0, np.inf),
    ],
)
def test_sizes(type_: str, size: str, kind: int, core: list[float], radius: float, bound: float) -> None:
    geom = f'<geom type="{type_}" size="{size}"/>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{geom}</worldbody></mujoco>")
    geoms = geoms_from(model, whole([0]), [], -1, {})
    assert geoms.kind[0] == kind
    np.testing.assert_allclose(geoms.core[0], core)
    np.testing.assert_allclose([geoms.radius[0], geoms.bound[0]], [radius, bound])


ARM = """<mujoco><asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset><worldbody>
<body><joint name="base" type="slide"/><geom size="0.1"/>
  <body name="upper"><joint name="{first}" type="{type}"/><geom name="{geom}" type="mesh" mesh="m"/>
    <body><joint name="elbow"/><geom name="tip" size="0.1"/></body></body></body>
<body><joint name="other"/><geom size="0.1"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("joints", "type_", "named"),
    [
        (["base", "elbow"], "hinge", "joint shoulder"),  # not listed
        (["base", "shoulder", "elbow"], "ball", "joint shoulder"),
        (["base", "shoulder", "elbow", "other"], "hinge", "joint other"),  # doesn't move the tip
        (["shoulder", "base", "elbow"], "hinge", "geom tip"),  # out of order
    ],
)
def test_a_wrong_chain_is_refused_by_name(joints: list[str], type_: str, named: str) -> None:
    model = mujoco.MjModel.from_xml_string(ARM.format(first="shoulder", type=type_, geom="shell"))
    with pytest.raises(InputError) as caught:
        chains_from(model, [[model.joint(j).id for j in joints]], [model.geom("tip").id])
    assert caught.value.field == named


def test_a_geom_without_an_owner_is_refused_by_name() -> None:
    model = mujoco.MjModel.from_xml_string(ARM.format(first="shoulder", type="hinge", geom="shell"))
    with pytest.raises(InputError, match=r"joint elbow.*no agent"):
        geoms_from(model, whole([model.geom("tip").id]), [[0, 1]], -1, {})


def test_a_mesh_is_the_primitives_that_stand_for_it_where_they_stand_in_it() -> None:
    model = mujoco.MjModel.from_xml_string(
        ARM.format(first="shoulder", type="hinge", geom="shell").replace(
            'mesh="m"/>', 'mesh="m" pos="1 2 3" euler="20 30 40"/>'
        )
    )
    shell, tip = model.geom("shell").id, model.geom("tip").id
    R = Rotation.random(4, random_state=0).as_matrix()
    p = np.random.default_rng(0).normal(size=(4, 3))
    sizes = {"sphere": [0.1, 0, 0], "capsule": [0.1, 0.5, 0], "cylinder": [0.1, 0.5, 0], "box": [0.1, 0.2, 0.3]}
    made = {shell: tuple(Primitive(k, np.array(s), R[i], p[i]) for i, (k, s) in enumerate(sizes.items()))}
    parts = [*((shell, i) for i in range(4)), (tip, 0)]
    joints = [[model.joint(name).id for name in ("base", "shoulder", "elbow")]]
    geoms = geoms_from(model, parts, joints, -1, made)
    assert geoms.kind.tolist() == [cores.POINT, cores.SEGMENT, cores.CYLINDER, cores.BOX, cores.POINT]
    np.testing.assert_allclose(geoms.core[:4, :3], [[0, 0, 0], [0, 0, 0.5], [0.1, 0.1, 0.5], [0.1, 0.2, 0.3]])
    np.testing.assert_allclose(geoms.radius, [0.1, 0.1, 0, 0, 0.1])
    assert geoms.link.tolist() == [1, 1, 1, 1, 2]
    chains = chains_from(model, joints, [tip])
    data, q = mujoco.MjData(model), np.array([0.3, -0.4, 0.5])
    data.qpos[model.jnt_qposadr[joints[0]]] = q
    mujoco.mj_kinematics(model, data)
    R_WL, p_WL = frames(chains, 0, q)
    R_WG, p_WG = data.geom_xmat[shell].reshape(3, 3), data.geom_xpos[shell]
    for i in range(4):
        np.testing.assert_allclose(R_WL[1] @ geoms.R_LG[i], R_WG @ R[i], atol=1e-12)
        np.testing.assert_allclose(R_WL[1] @ geoms.p_LG[i] + p_WL[1], R_WG @ p[i] + p_WG, atol=1e-12)
