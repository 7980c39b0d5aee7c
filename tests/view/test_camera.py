"""The camera: rays and pixels are inverse to each other, and what was to be seen is."""

import numpy as np
import pytest

from regrasp.view.camera import direction, fit


@pytest.mark.parametrize("seed", range(5))
def test_everything_asked_for_is_in_the_image(seed):
    rng = np.random.default_rng(seed)
    centres, radii = rng.normal(size=(6, 3)), rng.uniform(0.01, 0.4, 6)
    camera = fit(direction(*rng.uniform([0, 0.1], [6, 1.3])), centres, radii, 320, 240)
    around = rng.normal(size=(500, 3))
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    seen = camera.project(centres[:, None] + radii[:, None, None] * around)
    assert (seen >= 0).all()
    assert (seen <= [320, 240]).all()
    assert (np.ptp(seen.reshape(-1, 2), axis=0) > [0.6 * 320, 0.6 * 240]).any()


def test_the_pixel_of_a_point_on_a_ray_is_the_ray_s():
    rng = np.random.default_rng(0)
    camera = fit(direction(1.0, 0.5), np.zeros((1, 3)), np.ones(1), 320, 240)
    pixels = rng.uniform(0, [320, 240], (50, 2))
    points = camera.eye + rng.uniform(1, 9, (50, 1)) * camera.rays(pixels)
    assert np.allclose(camera.project(points), pixels, atol=1e-9)


def test_right_is_right_and_up_is_up():
    camera = fit(np.array([0.0, 1.0, 0.0]), np.zeros((1, 3)), np.ones(1), 320, 240)
    centre, x, z = camera.project(np.array([[0, 0, 0], [0.1, 0, 0], [0, 0, 0.1]]))
    assert np.allclose(centre, [160, 120])
    assert x[0] > 160
    assert z[1] < 120
