"""What drives can tell before anything is fitted: the directions of the parameters that they do not fix.

The sensitivities of the predicted speeds, weighed with the noise of the sensors and without what a free start of each
window explains, give an information matrix. A direction in which it has next to nothing is one that no fit can find,
and the parameters in it name the measurement that would settle it.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hil.core.errors import BadInputError, apart
from hil.identify.floor import NUISANCES, Parameter
from hil.identify.gauss_newton import Knowledge, information_of
from hil.identify.linearised import Experiment
from hil.identify.recorded import Array, Drive
from hil.identify.windows import twists

_POOR = 0.1
_USELESS = 0.5
_NOISE = 4.0
"""How much worse fits were than the sensors' noise alone would allow: the currents are noisy too."""
_CHANGE_S = 0.1
_LEAST_CHANGE = {
    "forward": (0.1, "m/s2", "mass_kg"),
    "sideways": (0.1, "m/s2", "mass_kg"),
    "turning": (0.3, "rad/s2", "inertia_kg_m2"),
}
"""The usual change of each speed that a drive must have, its unit, and what cannot be told without it."""
_SHARE = 0.3
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
"""What settles a direction in which the parameter has a share, the single measurement that does most first."""
_NEEDED = ("mass_kg", "inertia_kg_m2", "friction_coefficient")
"""Without these no prediction is worth anything."""


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
        """What cannot be told, and what would settle it."""
        if len(self.names) == 1:
            which = f"{self.names[0]} is known to {min(9.99, self.sigma):.0%} at best"
        else:
            which = f"{', '.join(self.names)} are told apart to {min(9.99, self.sigma):.0%} at best"
        return f"{which}; {self.remedy}"


class Outlook(NamedTuple):
    """What the drives can tell: the best possible standard deviation of each parameter, and what they leave open."""

    sigma: dict[str, float]
    unknown: tuple[Unknown, ...]


def check_excitation(drive: Drive) -> None:
    """Raise BadInputError for a drive whose speeds hardly change, such as a circle or a straight line at one speed.

    The noise of the currents alone would then look like a response, and inertia came out four times too large.
    """
    rows = max(1, round(_CHANGE_S / drive.period_s))
    ends = drive.angle_rad[1:-1:rows]
    speed = twists(np.diff(ends, axis=0) / (rows * drive.period_s), drive.robot)
    if drive.has_gyro:
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
    experiments: Sequence[Experiment], parameters: Sequence[Parameter], point: Array, known: Knowledge
) -> Outlook:
    """Return what can be told near ``point``, with what is known from elsewhere.

    Raises BadInputError for drives that leave mass, inertia or friction open.
    """
    information = information_of(experiments, point) / _NOISE**2 + known.information
    fitted = [place for place, one in enumerate(parameters) if not known.held[place] and one not in NUISANCES]
    inner = information[np.ix_(fitted, fitted)]
    values, vectors = np.linalg.eigh(inner)
    unknown = []
    for value, vector in zip(values, vectors.T, strict=True):
        sigma = float(1.0 / np.sqrt(max(value, 1e-12)))
        if sigma > _POOR:
            shares = sorted(zip(np.abs(vector), fitted, strict=True), reverse=True)
            names = tuple(parameters[place].name for share, place in shares if share > _SHARE)
            remedy = next((words for name, words in _REMEDIES if name in names), "drive on all axes at once")
            unknown.append(Unknown(names, sigma, remedy))
    sigmas = np.sqrt(np.sum(vectors**2 / np.maximum(values, 1e-12), axis=1))
    sigma_of = {parameters[place].name: float(one) for place, one in zip(fitted, sigmas, strict=True)}
    useless = [name for name in _NEEDED if sigma_of.get(name, 0.0) > _USELESS]
    if useless:
        words = "; ".join(one.sentence for one in unknown)
        raise BadInputError(f"these recordings cannot tell {' and '.join(useless)}: {words}")
    return Outlook(sigma_of, tuple(unknown))
