"""A motion that shows all parameters of a robot: sines of many frequencies on all three axes at once.

One axis at a time tells less: inertia came out four times worse (hil/addons/identify/METHOD.md).
"""

import functools
import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
import numpy.typing as npt

from hil.core.errors import BadInputError
from hil.core.options import NOT_NEGATIVE, POSITIVE, Range
from hil.core.types import Axes, Pose, Reference
from hil.references.source import Phase, at_rest, motion_through, ramped

_SAMPLED_S = 120.0
_SAMPLE_S = 0.01
_SLOW_HZ = 0.1
_MARGIN = 0.97  # between two samples a sum of sines is a little higher


@dataclass(frozen=True, slots=True)
class Multisine:
    """Sines of many frequencies on x, y and heading at once, within a room and limits of its own: for hil identify.

    The speed of a tone falls with the root of its frequency; the frequencies ascend by a constant factor from
    ``lowest_hz`` to ``highest_hz``, those of the three axes in turn. Phases are random, by ``seed``. Only tones below
    0.1 Hz begin at their fastest, so that they swing about the start and use the room. One factor scales x and y, so
    that the first of three limits is met: ``speed_m_s``, ``acceleration_m_s2`` and ``room_m``. The last is the side of
    a square around the start; the robot's centre stays in it. The heading is scaled by
    ``yaw_rate_rad_s`` and ``yaw_acceleration_rad_s2``. Limits hold for the first two minutes. The robot rests for
    ``rest_s``, and then begins within ``ramp_s``.
    """

    speed_m_s: Annotated[float, NOT_NEGATIVE] = 0.8
    acceleration_m_s2: Annotated[float, POSITIVE] = 2.5
    yaw_rate_rad_s: Annotated[float, NOT_NEGATIVE] = 2.0
    yaw_acceleration_rad_s2: Annotated[float, POSITIVE] = 8.0
    room_m: Annotated[float, POSITIVE] = 3.0
    lowest_hz: Annotated[float, Range(ge=0.01, le=5)] = 0.06
    highest_hz: Annotated[float, Range(ge=0.02, le=10)] = 2.6
    tones: Annotated[int, Range(ge=2, le=40)] = 12
    seed: Annotated[int, Range(ge=0, le=2**32 - 1)] = 1
    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0
    rest_s: Annotated[float, NOT_NEGATIVE] = 3.0
    ramp_s: Annotated[float, NOT_NEGATIVE] = 1.0

    ends: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if self.highest_hz <= self.lowest_hz:
            raise BadInputError(
                f"reference.highest_hz = {self.highest_hz:g}: expected more than lowest_hz = {self.lowest_hz:g}"
            )

    @property
    def span_s(self) -> float:
        """Rest, ramp, and a period of the slowest tone [s]."""
        return self.rest_s + self.ramp_s + 1.0 / self.lowest_hz

    def at(self, t_s: float) -> Reference:
        """Return the reference at ``t_s``."""
        if t_s <= self.rest_s:
            return at_rest(Pose(self.x_m, self.y_m, self.heading_rad))
        moving = t_s - self.rest_s
        phase: Phase = ramped(moving, 1.0, self.ramp_s)
        passed, rate, acceleration = phase
        ways, speeds, changes = zip(*(_sum(tones, passed) for tones in _tones(self)), strict=True)
        pose = (self.x_m + ways[0], self.y_m + ways[1], self.heading_rad + ways[2])
        return motion_through((pose, speeds, changes), rate, acceleration)


_Tone = tuple[float, float, float, float, float, float]
"""Amplitude of the speed, angular frequency [rad/s] and phase [rad]; amplitudes of way and acceleration, and the sine
of the phase."""


def _sum(tones: tuple[_Tone, ...], t_s: float) -> Axes:
    """Return way, speed and acceleration of an axis after ``t_s``; the way is 0 at the start."""
    way = speed = change = 0.0
    for amplitude, frequency, phase, of_way, of_change, at_start in tones:
        angle = frequency * t_s + phase
        sine = math.sin(angle)
        way += of_way * (sine - at_start)
        speed += amplitude * math.cos(angle)
        change -= of_change * sine
    return way, speed, change


@functools.lru_cache(maxsize=16)
def _tones(options: Multisine) -> tuple[tuple[_Tone, ...], ...]:
    """Return the tones of x, y and heading, scaled to the limits."""
    random = np.random.default_rng(options.seed)
    count = options.tones
    # The three axes share one ladder, each with every third rung.
    ladder = np.geomspace(options.lowest_hz, options.highest_hz, 3 * count) * math.tau
    phases = random.uniform(0.0, math.tau, (3, count))
    frequencies = np.stack([ladder[axis::3] for axis in range(3)])
    phases = np.where(frequencies < _SLOW_HZ * math.tau, np.where(phases < math.pi, 0.0, math.pi), phases)
    t_s = np.arange(0.0, _SAMPLED_S, _SAMPLE_S)
    shares = np.sqrt(frequencies[:, :1] / frequencies)
    sampled = [_sampled(t_s, *one) for one in zip(shares, frequencies, phases, strict=True)]
    ways, speeds, changes = zip(*sampled, strict=True)
    half = options.room_m / 2.0
    linear = _MARGIN * min(
        options.speed_m_s / float(np.hypot(speeds[0], speeds[1]).max()),
        options.acceleration_m_s2 / float(np.hypot(changes[0], changes[1]).max()),
        half / float(max(np.abs(ways[0]).max(), np.abs(ways[1]).max())),
    )
    turning = _MARGIN * min(
        options.yaw_rate_rad_s / float(np.abs(speeds[2]).max()),
        options.yaw_acceleration_rad_s2 / float(np.abs(changes[2]).max()),
    )
    return tuple(
        tuple(
            _tone(scale * float(a), float(frequency), float(phase)) for a, frequency, phase in zip(*both, strict=True)
        )
        for scale, *both in zip((linear, linear, turning), shares, frequencies, phases, strict=True)
    )


def _tone(amplitude: float, frequency: float, phase: float) -> _Tone:
    return amplitude, frequency, phase, amplitude / frequency, amplitude * frequency, math.sin(phase)


_Series = npt.NDArray[np.float64]


def _sampled(t_s: _Series, shares: _Series, frequencies: _Series, phases: _Series) -> tuple[_Series, _Series, _Series]:
    """Return way, speed and acceleration of an axis over time; the shares are the amplitudes of the speed."""
    angles = np.outer(t_s, frequencies) + phases
    ways = (np.sin(angles) - np.sin(phases)) @ (shares / frequencies)
    return ways, np.cos(angles) @ shares, -np.sin(angles) @ (shares * frequencies)
