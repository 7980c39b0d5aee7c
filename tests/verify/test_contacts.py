"""Where a ball touches a cylinder with rounded edges, in closed form."""

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from regrasp.scene.matter import Part
from regrasp.verify.contacts import _under, measure
from regrasp.verify.motion import interpolate

R, H, E = 0.03, 0.04, 0.006


def cylinder(rng: np.random.Generator) -> Part:
    return Part(3, np.array([R, H, 0.0, E]), Rotation.random(rng=rng).as_matrix(), rng.normal(size=3), np.zeros((0, 3)))


def meridian(count: int) -> np.ndarray:
    """Points (distance from the axis, height) of the cylinder's outline from one pole to the other."""
    turn = np.linspace(0.0, np.pi / 2, count)
    rim = np.stack([R - E + E * np.sin(turn), H - E + E * np.cos(turn)], axis=1)
    face = np.stack([np.linspace(0.0, R - E, count), np.full(count, H)], axis=1)
    side = np.stack([np.full(count, R), np.linspace(H - E, E - H, count)], axis=1)
    return np.concatenate([face, rim, side, (rim * [1, -1])[::-1], (face * [1, -1])[::-1]])


def test_no_point_of_the_surface_is_nearer():
    rng = np.random.default_rng(0)
    outline = meridian(2000)
    for _ in range(200):
        part = cylinder(rng)
        way, high, turn = rng.uniform(R - E, R + 0.02), rng.uniform(H - E, H + 0.02), rng.uniform(0, 2 * np.pi)
        local = np.array([way * np.cos(turn), way * np.sin(turn), high * rng.choice([-1.0, 1.0])])
        if np.hypot(way - (R - E), high - (H - E)) <= E:
            continue  # inside
        point, normal = _under(part, part.R_OP @ local + part.p_OP)
        p, n = part.R_OP.T @ (point - part.p_OP), part.R_OP.T @ normal
        least = np.linalg.norm(outline - [way, local[2]], axis=1).min()
        np.testing.assert_allclose(np.linalg.norm(local - p), least, atol=1e-7)
        np.testing.assert_allclose(local - p, np.linalg.norm(local - p) * n, atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(n), 1.0, atol=1e-12)


def test_a_ball_on_the_side_next_to_the_rim_touches_the_round_side(handmade):
    """The capsules that the rim is made of stand out over the side by some µm, and would be met up to 0.5 mm away."""
    plan, world = handmade["rim"]
    part, tip = world.matter.parts[0], world.agents[0]
    radius, half, _, rounding = part.size
    for beside in (1e-4, 3e-4, 6e-4):
        for turn in np.linspace(0.0, 0.2, 9):
            n = np.array([np.cos(turn), np.sin(turn), 0.0])
            p = radius * n + [0.0, 0.0, half - rounding - beside]
            motion = interpolate(plan, world)
            motion.p_OT[:, :, 0] = p + tip.tip_size[0] * n
            motion.geom_xpos[:, :, tip.tip_geom] = motion.p_WO + (motion.R_WO @ motion.p_OT[:, :, 0, :, None])[..., 0]
            n_O = plan.n_O.copy()
            n_O[:, :, 0] = n
            found = measure(dataclasses.replace(plan, n_O=n_O), world, motion)
            np.testing.assert_allclose(found.p_O[:, :, 0], np.broadcast_to(p, found.p_O[:, :, 0].shape), atol=5e-5)
