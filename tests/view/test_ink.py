"""The colours with which something is said are told apart by eyes of every kind."""

import itertools

import numpy as np
import pytest

from regrasp.view import ink, strip

EYES = {
    "all cones": np.eye(3),
    # Machado, Oliveira, Fernandes 2009, severity 1.0, on linear sRGB.
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
}
XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
WHITE = XYZ @ np.ones(3)


def lab(colour: str, eye: np.ndarray) -> np.ndarray:
    """CIELAB of an sRGB colour as an eye sees it."""
    c = ink.rgb(colour)
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    t = XYZ @ np.clip(eye @ linear, 0.0, 1.0) / WHITE
    f = np.where(t > 216 / 24389, np.cbrt(t), (24389 / 27 * t + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize(
    ("colours", "least"),
    [
        ((*ink.AGENTS, ink.AGENT_FORCE, ink.SUPPORT_FORCE), 15.0),
        ((strip.STAY, strip.ROLL, strip.SLIP, strip.MOVE, strip.FREE), 9.0),
    ],
)
def test_no_two_colours_look_alike(colours, least, eye):
    """In CIE76's ΔE, of which 2.3 is a just noticeable difference."""
    for one, other in itertools.combinations(colours, 2):
        assert np.linalg.norm(lab(one, EYES[eye]) - lab(other, EYES[eye])) > least, (one, other)


def test_the_yardstick_knows_what_the_colour_blind_confuse():
    red, green = "#A05030", "#5E7F30"
    assert np.linalg.norm(lab(red, EYES["all cones"]) - lab(green, EYES["all cones"])) > 45
    assert np.linalg.norm(lab(red, EYES["deuteranopia"]) - lab(green, EYES["deuteranopia"])) < 15
    assert lab("#FFFFFF", EYES["deuteranopia"]) == pytest.approx([100.0, 0.0, 0.0], abs=0.1)
