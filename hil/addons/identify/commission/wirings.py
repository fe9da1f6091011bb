"""Which wiring fits what short pulses of torque did: every one is scored, and the best must lead.

A pulse of one channel accelerates the robot along the roller of its wheel and turns it. Accelerometer, gyro and the
encoders of the other three wheels see that. A wheel at (x, y) has the row h = (1, s, s x - y), s = -1 for FL and RR, 1
for FR and RL, and the opposite for rollers O. Driven at rest with the torque τ, it gives

    (ax, ay, α) = (h₁ / m', h₂ / m', h₃ / I') τ / r,    r ω̇ᵢ = hᵢ · (ax, ay, α)

with m' = m + 4 J / r² and I' = I + 4 J (L / r)². The score is the cosine between prediction and measurement, so that
the size of m, I and τ does not count, only the ratio of yaw to translation. IMU and encoders have a cosine each, of
which the score is the mean: the counts of a turn are not known yet.
"""

import functools
import itertools
import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from hil.addons.identify.commission.commission_session import Array
from hil.core.model import RobotModel
from hil.core.types import WHEEL_NAMES

Rollers = Literal["x", "o"]
Direction = Literal["forward", "backward", "left", "right", "turned left", "turned right"]
DIRECTIONS: tuple[Direction, ...] = ("forward", "backward", "left", "right", "turned left", "turned right")

FITS = 0.85  # the least score of a wiring that explains the measurement
LEAD = 0.02  # by how much a wiring must score less than the best to be ruled out
_TURNS = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))  # cosine and sine of quarter turns


class Candidate(NamedTuple):
    """A wiring: the wheel of each channel (0 to 3: FL, FR, RR, RL), its direction (1 or -1), rollers, and the IMU.

    ``quarter_turns`` is how far the IMU is turned to the left about the upright, after its third axis was laid upright.
    """

    wheels: tuple[int, ...]
    signs: tuple[int, ...]
    rollers: Rollers
    quarter_turns: int

    @property
    def wheel_names(self) -> tuple[str, ...]:
        """The wheel of each channel."""
        return tuple(WHEEL_NAMES[wheel] for wheel in self.wheels)

    @property
    def reversed_wheels(self) -> tuple[str, ...]:
        """The wheels whose motor direction is reversed."""
        return tuple(name for name, sign in zip(self.wheel_names, self.signs, strict=True) if sign < 0)

    @property
    def words(self) -> str:
        """The wiring for a person, without the IMU."""
        turned = ", ".join(self.reversed_wheels) or "none"
        return f"{', '.join(self.wheel_names)}; reversed: {turned}; rollers: {self.rollers.upper()}"


PLAIN = Candidate((0, 1, 2, 3), (1, 1, 1, 1), "x", 0)
"""Every output turns its own wheel forward."""
TRIED: tuple[Direction, ...] = ("forward", "left", "turned left")  # the motions by which a wiring is tried


class WheelSeen(NamedTuple):
    """Seen by a person: the wheel of a channel, and whether a positive torque turned it forward (1) or not (-1)."""

    channel: int
    wheel: int
    sign: int


class Responses(NamedTuple):
    """What pulses of the four channels did, each for a torque of one newton metre; NaN for what nothing measures.

    Attributes:
        acceleration_m_s2: level acceleration of the robot in the IMU's levelled frame, a row a channel.
        yaw_rad_s2: yaw acceleration, left positive.
        wheels_rad_s2: of the wheel of each channel (column), by its encoder in the direction of its own motor.
    """

    acceleration_m_s2: Array
    yaw_rad_s2: Array
    wheels_rad_s2: Array


class MotionSeen(NamedTuple):
    """Seen by a person: where the robot went when its channels were given torques in these proportions."""

    torques: tuple[float, ...]
    direction: Direction


Evidence = WheelSeen | MotionSeen


class Decision(NamedTuple):
    """The best wiring with its score, and the others that fit as well, as far as anybody can tell."""

    best: Candidate
    score: float
    rivals: tuple[Candidate, ...]

    @property
    def fits(self) -> bool:
        """Whether the best explains the measurement at all."""
        return self.score >= FITS

    @property
    def is_clear(self) -> bool:
        """Whether it fits and no other does."""
        return self.fits and not self.rivals

    @property
    def rollers(self) -> Rollers | None:
        """The rollers, where all that fit agree in them."""
        return self.best.rollers if all(one.rollers == self.best.rollers for one in self.rivals) else None


def rows(model: RobotModel, rollers: Rollers) -> Array:
    """Return h of the wheels FL, FR, RR, RL, one a row: 1, s and the lever of the yaw [m]."""
    front, left = np.array([1.0, 1.0, -1.0, -1.0]), np.array([1.0, -1.0, -1.0, 1.0])
    s = front * left if rollers == "o" else -front * left
    return np.stack([np.ones(4), s, s * front * model.half_length_m - left * model.half_width_m], axis=1)


def response(model: RobotModel, rollers: Rollers) -> tuple[Array, Array]:
    """Return what one newton metre at each wheel (row) does: (ax, ay, α), and r ω̇ of all four wheels."""
    h = rows(model, rollers)
    lever_m = abs(h[0][2])
    inertia = model.inertia_kg_m2 + model.wheels_mass_kg * lever_m**2
    body = h / np.array([model.effective_mass_kg, model.effective_mass_kg, inertia]) / model.wheel_radius_m
    return body, body @ h.T


@functools.cache
def _all(has_heading: bool) -> tuple[Candidate, ...]:
    signs = itertools.product((1, -1), repeat=4)
    rollers: tuple[Rollers, ...] = ("x", "o")
    every = itertools.product(itertools.permutations(range(4)), signs, rollers, range(4 if has_heading else 1))
    return tuple(itertools.starmap(Candidate, every))


def _features(body: Array, wheels: Array, yaw_m: float) -> tuple[Array, Array]:
    """Return comparable numbers [m/s²] of the IMU and of the encoders, without a wheel's own, which tells nothing."""
    return np.column_stack([body[:, :2], body[:, 2:] * yaw_m]).ravel(), wheels[~np.eye(4, dtype=bool)]


def _cosine(predicted: Array, measured: Array) -> float | None:
    """Return the cosine between the two where something was measured; None where nothing was."""
    known = np.isfinite(measured)
    size = float(np.linalg.norm(measured[known]) * np.linalg.norm(predicted[known]))
    return float(predicted[known] @ measured[known]) / size if size > 0.0 else None


def decide(model: RobotModel, seen: Responses, evidence: Sequence[Evidence] = ()) -> Decision:
    """Return the best wiring of those that agree with the ``evidence`` of a person.

    Raises ValueError when nothing was measured, or when no wiring agrees with the person.
    """
    yaw_m = yaw_lever_m(model)
    measured = _features(np.column_stack([seen.acceleration_m_s2, seen.yaw_rad_s2]), seen.wheels_rad_s2, yaw_m)
    if not any(np.nan_to_num(part).any() for part in measured):
        raise ValueError("nothing was measured")
    models: dict[Rollers, tuple[Array, Array]] = {"x": response(model, "x"), "o": response(model, "o")}
    scored = []
    for candidate in _all(bool(np.isfinite(seen.acceleration_m_s2).all())):
        if not all(_agrees(model, candidate, one) for one in evidence):
            continue
        body, wheels = models[candidate.rollers]
        order, sign = list(candidate.wheels), np.array(candidate.signs, dtype=float)
        c, s = _TURNS[candidate.quarter_turns]
        x, y, yaw = (body[order] * sign[:, None]).T
        turned = np.column_stack([c * x + s * y, c * y - s * x, yaw])
        predicted = _features(turned, wheels[np.ix_(order, order)] * np.outer(sign, sign), yaw_m)
        cosines = [_cosine(*pair) for pair in zip(predicted, measured, strict=True)]
        found = [cosine for cosine in cosines if cosine is not None]
        scored.append((sum(found) / max(len(found), 1), candidate))
    if not scored:
        raise ValueError("no wiring agrees with what was seen")
    scored.sort(key=lambda one: -one[0])
    (score, best), rest = scored[0], scored[1:]
    return Decision(best, score, tuple(one for rival, one in rest if score - rival < LEAD))


def pattern(candidate: Candidate, direction: Direction) -> tuple[float, ...]:
    """Return the torques of the channels that drive a robot of rollers X in a direction, each 1 or -1."""
    axis, way = divmod(DIRECTIONS.index(direction), 2)
    by_wheel = ((1, 1, 1, 1), (-1, 1, -1, 1), (-1, 1, 1, -1))[axis]
    signs = zip(candidate.wheels, candidate.signs, strict=True)
    return tuple((1.0, -1.0)[way] * sign * by_wheel[wheel] for wheel, sign in signs)


def direction_of(model: RobotModel, candidate: Candidate, torques: Sequence[float]) -> Direction:
    """Return where a robot of this wiring goes when its channels are given these torques."""
    body, _ = response(model, candidate.rollers)
    sign = np.array(candidate.signs) * np.array(torques)
    x, y, yaw = sign @ body[list(candidate.wheels)]
    return named_direction((x, y, yaw * yaw_lever_m(model)))


def named_direction(parts: Sequence[float]) -> Direction:
    """Return the direction of a motion: forward, left and turned to the left, in comparable units."""
    axis = max(range(3), key=lambda i: abs(parts[i]))
    return DIRECTIONS[2 * axis + (parts[axis] < 0.0)]


def yaw_lever_m(model: RobotModel) -> float:
    """Return the lever [m] by which a turn is compared with a way: the robot's radius of inertia."""
    return math.sqrt(model.effective_inertia_kg_m2 / model.effective_mass_kg)


def telling(model: RobotModel, decision: Decision) -> tuple[float, ...] | None:
    """Return torques that move the best and some rival in different directions; None where none do."""
    for direction in ("forward", "left"):
        torques = pattern(decision.best, direction)
        here = direction_of(model, decision.best, torques)
        if any(direction_of(model, rival, torques) != here for rival in decision.rivals):
            return torques
    return None


def _agrees(model: RobotModel, candidate: Candidate, one: Evidence) -> bool:
    if isinstance(one, MotionSeen):
        return direction_of(model, candidate, one.torques) == one.direction
    return candidate.wheels[one.channel] == one.wheel and candidate.signs[one.channel] == one.sign


def laid_upright(gravity_m_s2: Sequence[float]) -> tuple[str, str, str] | None:
    """Return the axes of an IMU at rest, its upright one as z, in some heading; None where it is not near one axis.

    The accelerometer shows +9.81 m/s² along the axis that points up.
    """
    size = [abs(value) for value in gravity_m_s2]
    up = size.index(max(size))
    if size[up] < 0.9 * math.dist((0, 0, 0), gravity_m_s2):
        return None
    axes = ["", "", ""]
    axes[up] = "z" if gravity_m_s2[up] > 0.0 else "-z"
    first, second = (up + 1) % 3, (up + 2) % 3  # (first, second, up) is right-handed in the IMU's own frame
    axes[first], axes[second] = ("x", "y") if gravity_m_s2[up] > 0.0 else ("y", "x")
    return axes[0], axes[1], axes[2]


def turned_axes(axes: Sequence[str], quarter_turns: int) -> tuple[str, str, str]:
    """Return the axes of an IMU that is turned to the left by so many quarters: its x then points to y, and so on."""
    turn = {"x": "y", "y": "-x", "-x": "-y", "-y": "x", "z": "z", "-z": "-z"}
    found = tuple(axes)
    for _ in range(quarter_turns):
        found = tuple(turn[axis] for axis in found)
    return found[0], found[1], found[2]
