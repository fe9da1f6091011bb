"""Colours drawn together differ for every kind of sight, on a dark and on a light ground.

Sight without red (protanopia) or green (deuteranopia) cones is simulated by Machado, Oliveira and Fernandes, IEEE TVCG
15 (2009), severity 1. The difference is CIEDE2000 (Sharma, Wu and Dalal, 2005); contrast is that of WCAG 2.
"""

import itertools
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pytest

from hil.pages.plots import (
    ALARM_COLOUR,
    ESTIMATE_COLOUR,
    HEADING_COLOUR,
    PLAIN_COLOUR,
    REFERENCE_COLOUR,
    TRUTH_COLOUR,
    X_COLOUR,
    Y_COLOUR,
    Colour,
)

SIGHTS = {
    "full": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
}
DARK, LIGHT = (13, 16, 17), (255, 255, 255)  # the ground of a plot in rerun's two themes
NAMED = {
    "x": X_COLOUR,
    "y": Y_COLOUR,
    "bound": ALARM_COLOUR,
    "truth": TRUTH_COLOUR,
    "heading": HEADING_COLOUR,
    "reference": REFERENCE_COLOUR,
    "estimate": ESTIMATE_COLOUR,
    "plain": PLAIN_COLOUR,
}
TOGETHER: Sequence[Sequence[str]] = (
    ("x", "y", "bound", "truth", "heading"),
    ("reference", "estimate", "truth", "bound"),  # the plan and the scene; timings
    ("x", "y", "plain", "heading", "bound"),  # errors
)
Lab = npt.NDArray[np.float64]


def linear(colour: Colour) -> npt.NDArray[np.float64]:
    share = np.array(colour) / 255.0
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def lab(colour: Colour, sight: str) -> Lab:
    seen = np.clip(SIGHTS[sight] @ linear(colour), 0.0, 1.0)
    to_xyz = [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
    share = np.array(to_xyz) @ seen / [0.95047, 1.0, 1.08883]
    x, y, z = np.where(share > 216 / 24389, np.cbrt(share), (24389 / 27 * share + 16) / 116)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def ciede2000(one: Lab, other: Lab) -> float:
    mean_chroma = (np.hypot(*one[1:]) + np.hypot(*other[1:])) / 2
    stretch = 1 + 0.5 * (1 - np.sqrt(mean_chroma**7 / (mean_chroma**7 + 25.0**7)))
    (l1, a1, b1), (l2, a2, b2) = one * [1, stretch, 1], other * [1, stretch, 1]
    c1, c2 = np.hypot(a1, b1), np.hypot(a2, b2)
    h1, h2 = np.degrees(np.arctan2([b1, b2], [a1, a2])) % 360
    grey = c1 * c2 == 0
    turn = 0.0 if grey else (h2 - h1 + 180) % 360 - 180
    hue = h1 + h2 if grey else (h1 + turn / 2) % 360
    light, chroma = (l1 + l2) / 2, (c1 + c2) / 2
    cosines = [np.cos(np.radians(angle)) for angle in (hue - 30, 2 * hue, 3 * hue + 6, 4 * hue - 63)]
    weight = 1 + np.dot([-0.17, 0.24, 0.32, -0.20], cosines)
    rotation = 60 * np.exp(-(((hue - 275) / 25) ** 2))
    share = -2 * np.sqrt(chroma**7 / (chroma**7 + 25.0**7)) * np.sin(np.radians(rotation))
    lightness = (l2 - l1) / (1 + 0.015 * (light - 50) ** 2 / np.sqrt(20 + (light - 50) ** 2))
    chromatic = (c2 - c1) / (1 + 0.045 * chroma)
    tone = 2 * np.sqrt(c1 * c2) * np.sin(np.radians(turn / 2)) / (1 + 0.015 * chroma * weight)
    return float(np.sqrt(lightness**2 + chromatic**2 + tone**2 + share * chromatic * tone))


def contrast(one: Colour, other: Colour) -> float:
    dark, light = sorted(float(np.dot([0.2126, 0.7152, 0.0722], linear(colour))) for colour in (one, other))
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.parametrize(
    ("one", "other", "difference"),
    [
        ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
        ((50.0, 2.5, 0.0), (73.0, 25.0, -18.0), 27.1492),
        ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
        ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
    ],
)
def test_the_difference_is_that_of_its_authors(one: Lab, other: Lab, difference: float) -> None:
    """Pairs of the table that Sharma, Wu and Dalal publish for checking implementations."""
    assert ciede2000(np.array(one), np.array(other)) == pytest.approx(difference, abs=1e-4)


@pytest.mark.parametrize("sight", SIGHTS)
def test_colours_that_are_drawn_together_are_apart(sight: str) -> None:
    for group in TOGETHER:
        for one, other in itertools.combinations(group, 2):
            difference = ciede2000(lab(NAMED[one], sight), lab(NAMED[other], sight))
            assert difference >= 15.0, f"{one} and {other}: {difference:.1f}"


@pytest.mark.parametrize("ground", [DARK, LIGHT])
def test_colours_stand_out_from_the_ground(ground: Colour) -> None:
    for name, colour in NAMED.items():
        assert contrast(colour, ground) >= 2.5, f"{name}: {contrast(colour, ground):.1f}"
