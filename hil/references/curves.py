"""Sections of a path by arc length: lines and bends, and the heading along them.

The parameter s of a section is the distance in metres, or the angle in radians for a turn on the spot. A curve gives
the position, a heading law the heading, each with its first and second derivative by s.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hil.core.types import Axes
from hil.references.source import Point

Series = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

Plane = tuple[float, float, float, float, float, float]  # x, y, x', y', x'', y''


class Line(NamedTuple):
    """A straight line. With the direction (0, 0) it is a point, on which the robot turns."""

    x: float
    y: float
    x1: float
    y1: float

    def plane(self, s: float) -> Plane:
        """Return the position at ``s`` and its derivatives."""
        return self.x + s * self.x1, self.y + s * self.y1, self.x1, self.y1, 0.0, 0.0


class Linear(NamedTuple):
    """A heading that changes linearly with s."""

    heading: float
    slope: float = 0.0

    def angle(self, s: float) -> Axes:
        """Return the heading at ``s`` and its two derivatives."""
        return self.heading + s * self.slope, self.slope, 0.0


EASED_PEAKS = (15.0 / 8.0, 10.0 / math.sqrt(3.0), 60.0)
"""Largest first, second and third derivative of 10 u³ - 15 u⁴ + 6 u⁵ for u from 0 to 1."""


class Eased(NamedTuple):
    """A heading that changes smoothly over a length, with first and second derivative zero at both ends.

    It follows 10 u³ - 15 u⁴ + 6 u⁵ with u = (s + offset) / length.
    """

    heading: float
    change: float
    length: float
    offset: float

    def angle(self, s: float) -> Axes:
        """Return the heading at ``s`` and its two derivatives."""
        u = (s + self.offset) / self.length
        scale = self.change / self.length
        return (
            self.heading + self.change * u * u * u * (10.0 + u * (6.0 * u - 15.0)),
            scale * 30.0 * u * u * (1.0 - u) * (1.0 - u),
            scale / self.length * 60.0 * u * (1.0 + u * (2.0 * u - 3.0)),
        )


class Bend:
    """A curve that turns by an angle; its curvature rises from zero and falls back as 1 - cos.

    At constant speed neither the acceleration nor the yaw acceleration jumps. The direction and the derivatives of the
    position are exact. The position is interpolated by quintic Hermite polynomials, to 1e-11 of the length.
    """

    PIECES = 64

    def __init__(self, x: float, y: float, direction: float, turn: float, tangent_m: float) -> None:
        """Begin at (x, y) in a direction [rad] and turn left by ``turn`` [rad], between -π and π.

        The bend begins ``tangent_m`` [m] before the corner and ends as far behind it.
        """
        nodes = np.linspace(0.0, 1.0, self.PIECES + 1)
        abscissas, weights = np.polynomial.legendre.leggauss(6)
        u = nodes[:-1, None] + (abscissas + 1.0) * (0.5 / self.PIECES)
        tangents = np.exp(1j * _turned(u, turn))
        places = np.concatenate(([0.0], np.cumsum(tangents @ weights) * (0.5 / self.PIECES)))
        # By symmetry the chord is the base of an isosceles triangle, whose two equal sides are the tangents.
        self.length = tangent_m * 2.0 * math.cos(turn / 2.0) / float(abs(places[-1]))
        self.direction = direction
        self.turn = turn
        self.tangent_m = tangent_m
        start = np.exp(1j * direction)
        places = complex(x, y) + places * (self.length * start)
        slopes = np.exp(1j * _turned(nodes, turn)) * (self.length * start)
        bends = slopes * 1j * turn * (1.0 - np.cos(math.tau * nodes))
        self._table = _quintics(places, slopes, bends)

    @property
    def peak_curvature(self) -> float:
        """The largest curvature [1/m], in its middle; not negative."""
        return 2.0 * abs(self.turn) / self.length

    @property
    def peak_sharpness(self) -> float:
        """The largest change of curvature along the way [1/m²]; not negative."""
        return math.tau * abs(self.turn) / self.length**2

    def plane(self, s: float) -> Plane:
        """Return the position at ``s`` and its derivatives."""
        direction, curvature, _ = self.angle(s)
        c, sine = math.cos(direction), math.sin(direction)
        place = s / self.length * self.PIECES
        piece = min(max(int(place), 0), self.PIECES - 1)
        r = place - piece
        p0, p1, p2, p3, p4, p5 = self._table[piece]
        z = p0 + r * (p1 + r * (p2 + r * (p3 + r * (p4 + r * p5))))
        return z.real, z.imag, c, sine, -curvature * sine, curvature * c

    def angle(self, s: float) -> Axes:
        """Return the direction of the path, its curvature, and the slope of that."""
        u = math.tau * s / self.length
        scale = self.turn / self.length
        return (
            self.direction + self.turn * (u - math.sin(u)) / math.tau,
            scale * (1.0 - math.cos(u)),
            scale * math.tau / self.length * math.sin(u),
        )


Curve = Line | Bend
HeadingLaw = Linear | Eased | Bend


class Section(NamedTuple):
    """A curve with the heading along it."""

    curve: Curve
    law: HeadingLaw

    def point(self, s: float, turned: float = 0.0) -> Point:
        """Return the point of the path at ``s``, the heading ``turned`` further [rad]."""
        x, y, x1, y1, x2, y2 = self.curve.plane(s)
        heading, heading1, heading2 = self.law.angle(s)
        return (x, y, heading + turned), (x1, y1, heading1), (x2, y2, heading2)


def _turned(u: Series, turn: float) -> Series:
    """Return the angle by which a bend has turned after the share u of its length."""
    return turn * (u - np.sin(math.tau * u) / math.tau)


def _quintics(places: Complexes, slopes: Complexes, bends: Complexes) -> list[tuple[complex, ...]]:
    """Return the coefficients, lowest first, of one polynomial over 0 to 1 for each step between two nodes.

    ``slopes`` and ``bends`` are its first and second derivatives by a parameter from 0 (first node) to 1 (last one).
    """
    h = 1.0 / (len(places) - 1)
    p, q = places[:-1], places[1:]
    v, w = slopes[:-1] * h, slopes[1:] * h
    a, b = bends[:-1] * h * h, bends[1:] * h * h
    d = q - p - v - 0.5 * a
    e = w - v - a
    f = b - a
    last = (10.0 * d - 4.0 * e + 0.5 * f, -15.0 * d + 7.0 * e - f, 6.0 * d - 3.0 * e + 0.5 * f)
    return list(zip(*(column.tolist() for column in (p, v, 0.5 * a, *last)), strict=True))
