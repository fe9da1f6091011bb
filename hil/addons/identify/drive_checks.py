"""Refuses drives that show a faulty robot or floor, or that tell too little, each with a sentence.

The sensitivities of the predicted speeds give an information matrix, weighed with the noise of the sensors, without the
part that a free start of each window explains. No fit can find a direction with almost no information. The parameters
in it name the measurement that would settle it.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hil.addons.identify.drives import Array, Drive, integral
from hil.addons.identify.gauss_newton import Knowledge, information_of
from hil.addons.identify.linearised import Experiment
from hil.addons.identify.windows import MEASURED, NUISANCES, Parameter, Windows, twists
from hil.core.errors import BadInputError, apart
from hil.core.model import GRAVITY_M_S2, RobotModel
from hil.core.types import WHEEL_NAMES

_LEAST_SHARE = 0.1  # of what the other wheels do
_SLOPE_M_S2 = 0.06
_SIGMAS = 6.0


def check_motors(drive: Drive) -> None:
    """Raise BadInputError for a drive without currents, with a blocked wheel, or with a dead current sensor.

    All four wheels are driven alike in the drives of an identification, so one that does almost nothing stands out.
    """
    if not drive.has_currents:
        raise BadInputError(
            f"{drive.path}: the robot measured no currents. Without them mass, inertia, friction and grip are not "
            "identifiable; hil commission finds the radius of the wheels and the lever"
        )
    turned, drawn = drive.speed_rad_s.std(axis=0), drive.current_a.std(axis=0)
    for wheel, speed, current in zip(WHEEL_NAMES, turned, drawn, strict=True):
        if speed < _LEAST_SHARE * np.median(turned):
            raise BadInputError(
                f"{drive.path}: wheel {wheel} turned next to nothing while the others did: it is blocked, or its "
                "encoder is dead; nothing was fitted"
            )
        if current < _LEAST_SHARE * np.median(drawn):
            raise BadInputError(
                f"{drive.path}: wheel {wheel} turned, but its current sensor shows next to nothing: it is dead, or the "
                "motor is not driven; nothing was fitted"
            )


def check_level(drive: Drive, windows: Windows, left: Array, robot: RobotModel) -> None:
    """Raise BadInputError for a floor that slopes: in all windows, something pushed the robot the same way.

    ``left`` (W, B * 5) is what a fitted model leaves of the windows. Its trend within a window is an acceleration that
    no motor made.
    """
    by_bin = left.reshape(len(left), -1, MEASURED)[..., : len(WHEEL_NAMES)]
    time_s = windows.rows_a_bin * windows.period_s * np.arange(by_bin.shape[1])
    time_s -= time_s.mean()
    trend = np.einsum("b,wbi->wi", time_s, by_bin) / np.sum(time_s**2)
    heading = integral(drive.yaw_rate_rad_s, drive.period_s)[windows.first]
    along, aside, _ = twists(trend, robot).T
    c, s = np.cos(heading), np.sin(heading)
    pushed = np.stack([c * along - s * aside, s * along + c * aside], axis=1)
    usual = np.median(pushed, axis=0)
    spread = 1.4826 * np.median(np.abs(pushed - usual), axis=0)
    size, doubt = float(np.hypot(*usual)), float(np.hypot(*spread)) / np.sqrt(len(pushed))
    if size > max(_SLOPE_M_S2, _SIGMAS * doubt):
        degrees = np.degrees(np.arcsin(min(1.0, size / GRAVITY_M_S2)))
        raise BadInputError(
            f"{drive.path}: something pushed the robot one way all the time, as a floor does that slopes by "
            f"{degrees:.1f} degrees or more; drive where it is level. Nothing was fitted"
        )


_POOR = 0.1
_USELESS = 0.5
_NOISE = 4.0  # how much worse fits were than the sensors' noise alone would allow: the currents are noisy too
_CHANGE_S = 0.1
_LEAST_CHANGE = {
    "forward": (0.1, "m/s2", "mass_kg"),
    "sideways": (0.1, "m/s2", "mass_kg"),
    "turning": (0.3, "rad/s2", "inertia_kg_m2"),
}
"""The usual change of each speed that a drive must have, its unit, and the parameter that is unknown without it."""
_NAMED_SHARE = 0.3
_REMEDIES = (
    ("grip_coefficient", "squeeze the wheels against one another until they slip (hil identify drive)"),
    ("roller_stiffness_n_m", "drive to and fro faster; it matters little elsewhere"),
    ("roller_friction_coefficient", "coast along the rollers; it matters little elsewhere"),
    ("wheel_inertia_kg_m2", "spin the wheels on blocks (hil identify drive, --blocks)"),
    ("viscous_n_m_s_rad", "spin the wheels on blocks (hil identify drive, --blocks)"),
    ("com_x_m", "turn while driving"),
    ("com_y_m", "turn while driving"),
    ("inertia_kg_m2", "turn to and fro while driving: hil identify drive does so on all axes at once"),
    ("mass_kg", "accelerate to and fro on all axes at once, as hil identify drive does"),
    ("friction_coefficient", "drive at speeds from slow to fast"),
)
"""The measurement that settles a direction, by a parameter with a share in it; the most useful one first."""
_NEEDED = ("mass_kg", "inertia_kg_m2", "friction_coefficient")  # without these no prediction is worth anything


class Unknown(NamedTuple):
    """A direction that the drives leave open.

    Attributes:
        names: the parameters in it, that with the largest share first.
        sigma: standard deviation along it: of logarithms, or in the units of the fit.
        remedy: the single measurement that would settle it.
    """

    names: tuple[str, ...]
    sigma: float
    remedy: str

    @property
    def sentence(self) -> str:
        """The unknown parameters, and the measurement that would settle them."""
        if len(self.names) == 1:
            which = f"{self.names[0]} is known to {min(9.99, self.sigma):.0%} at best"
        else:
            which = f"{', '.join(self.names)} are told apart to {min(9.99, self.sigma):.0%} at best"
        return f"{which}; {self.remedy}"


def check_excitation(drive: Drive) -> None:
    """Raise BadInputError for a drive whose speeds hardly change, such as a circle or a straight line at one speed.

    The noise of the currents alone would then look like a response, and inertia came out four times too large.
    """
    rows = max(1, round(_CHANGE_S / drive.period_s))
    ends = drive.angle_rad[1:-1:rows]
    speed = twists(np.diff(ends, axis=0) / (rows * drive.period_s), drive.robot)
    count = (len(drive.yaw_rate_rad_s) - 2) // rows
    speed = speed[:count]
    speed[:, 2] = drive.yaw_rate_rad_s[1 : 1 + count * rows].reshape(count, rows).mean(axis=1)[: len(speed)]
    # The median: one start or stop does not make a drive.
    usual = 1.4826 * np.median(np.abs(np.diff(speed, axis=0)), axis=0) / (rows * drive.period_s)
    for change, (axis, (least, unit, parameter)) in zip(usual, _LEAST_CHANGE.items(), strict=True):
        if change < least:
            raise BadInputError(
                f"{drive.path}: the {axis} speed usually changes by {apart(change, least, digits=2)} {unit}; expected "
                f"at least {least:g} {unit}, or the recording cannot tell {parameter}: a circle or a line at one "
                "speed does not, drive on all axes at once (hil identify drive)"
            )


def outlook(
    experiment: Experiment, parameters: Sequence[Parameter], point: Array, known: Knowledge
) -> tuple[Unknown, ...]:
    """Return what a fit near ``point`` cannot determine; ``known`` is knowledge from other measurements.

    Raises BadInputError for a drive that leaves mass, inertia or friction open.
    """
    information = information_of(experiment, point) / _NOISE**2 + known.information
    fitted = [place for place, one in enumerate(parameters) if not known.held[place] and one not in NUISANCES]
    values, vectors = np.linalg.eigh(information[np.ix_(fitted, fitted)])
    unknown = []
    for value, vector in zip(values, vectors.T, strict=True):
        sigma = float(1.0 / np.sqrt(max(value, 1e-12)))
        if sigma > _POOR:
            shares = sorted(zip(np.abs(vector), fitted, strict=True), reverse=True)
            names = tuple(parameters[place].name for share, place in shares if share > _NAMED_SHARE)
            remedy = next((words for name, words in _REMEDIES if name in names), "drive on all axes at once")
            unknown.append(Unknown(names, sigma, remedy))
    sigmas = np.sqrt(np.sum(vectors**2 / np.maximum(values, 1e-12), axis=1))
    sigma_of = {parameters[place].name: float(one) for place, one in zip(fitted, sigmas, strict=True)}
    useless = [name for name in _NEEDED if sigma_of.get(name, 0.0) > _USELESS]
    if useless:
        words = "; ".join(one.sentence for one in unknown)
        raise BadInputError(f"these recordings cannot tell {' and '.join(useless)}: {words}")
    return tuple(unknown)
