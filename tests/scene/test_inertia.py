"""Inertias that no body can have become the nearest that one can have; the others stay."""

import mujoco
import numpy as np
import pytest

from regrasp.scene import inertia


def second_moments(given: np.ndarray) -> np.ndarray:
    return np.linalg.eigvalsh(np.trace(given) / 2 * np.eye(3) - given)


def of_points(rng: np.random.Generator) -> np.ndarray:
    """The inertia of a few point masses about their centre."""
    p, m = rng.normal(size=(6, 3)), rng.uniform(0.1, 1.0, 6)
    p -= m @ p / m.sum()
    return sum(mass * (x @ x * np.eye(3) - np.outer(x, x)) for mass, x in zip(m, p, strict=True))


def test_the_inertia_of_a_real_body_stays() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        given = of_points(rng)
        assert inertia.physical(given) is given


def test_any_other_becomes_one_of_a_real_body_and_no_real_one_is_nearer() -> None:
    rng = np.random.default_rng(1)
    repaired = 0
    for _ in range(100):
        A = rng.normal(size=(3, 3))
        given = A + A.T
        J = inertia.physical(given)
        if J is given:
            continue
        repaired += 1
        np.testing.assert_allclose(J, J.T, atol=1e-14)
        moments = second_moments(J)
        assert moments.min() >= (1 - 1e-9) * inertia.THINNEST * moments.max() > 0.0
        np.testing.assert_allclose(inertia.physical(J), J, atol=1e-14)
        # Nearness is measured between the second moments, up to the least thickness.
        far = np.linalg.norm(np.trace(given) / 2 * np.eye(3) - given - (np.trace(J) / 2 * np.eye(3) - J))
        slack = 2 * inertia.THINNEST * moments.max()
        for _ in range(20):
            K = of_points(rng) * rng.uniform(0.01, 2.0)
            other = np.linalg.norm(np.trace(given) / 2 * np.eye(3) - given - (np.trace(K) / 2 * np.eye(3) - K))
            assert far <= other + slack
    assert repaired > 50


def test_a_rod_without_thickness_gets_some() -> None:
    """Its smallest principal inertia is zero, about which a joint would spin without resistance."""
    J = inertia.physical(np.diag([0.0, 1.0, 1.0]))
    assert np.linalg.eigvalsh(J).min() > 0.0
    np.testing.assert_allclose(J, np.diag([0.0, 1.0, 1.0]), atol=3e-3)


BODY = """<mujoco><worldbody><body name="arm"><joint/> {inertial}
<body name="hand" pos="0 0 1"><joint/><geom size="0.1" {mass}/></body></body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("inertial", "mass", "said"),
    [
        ("", "", "body 'arm' moves and has no mass"),
        ('<inertial pos="0 0 0" mass="1" diaginertia="1 1 5"/>', "", "body 'arm' has principal inertias"),
        ('<inertial pos="0 0 0" mass="1" fullinertia="1 1 1 2 0 0"/>', "", "body 'arm' has principal inertias"),
        ('<inertial pos="0 0 0" mass="1" diaginertia="0 0 0"/>', "", "body 'arm' has no inertia"),
        ('<inertial pos="0 0 0" mass="0" diaginertia="1 1 1"/>', "", "body 'arm' moves and has mass 0"),
        ('<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>', 'mass="0"', "body 'hand' moves and has no mass"),
    ],
)
def test_what_mujoco_refuses_it_takes_afterwards(inertial: str, mass: str, said: str) -> None:
    spec = mujoco.MjSpec.from_string(BODY.format(inertial=inertial, mass=mass))
    with pytest.raises(ValueError, match=r"inertia|mass"):
        spec.compile()
    spec = mujoco.MjSpec.from_string(BODY.format(inertial=inertial, mass=mass))
    (repair,) = inertia.repair(spec)
    assert repair.startswith(said)
    model = spec.compile()
    assert np.all(model.body_mass[1:] > 0.0)
    assert np.all(model.body_inertia[1:] > 0.0)


def test_a_body_whose_geoms_weigh_enough_is_left_alone() -> None:
    spec = mujoco.MjSpec.from_string(BODY.format(inertial='<geom size="0.1"/>', mass=""))
    assert inertia.repair(spec) == []
