"""Fits a plant to drives: kinematics first, then dynamics, without slip and with it; a held-out drive chooses."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

import plant_fmu
from hil.addons.identify.before import ROLLERS, STIFFNESS, Before, BlocksFit, fit_blocks
from hil.addons.identify.currents import quiet
from hil.addons.identify.drive_checks import Unknown, check_excitation, check_level, check_motors, outlook
from hil.addons.identify.drives import Array, Drive
from hil.addons.identify.fit_kinematics import Kinematics, fit_kinematics, with_geometry
from hil.addons.identify.gauss_newton import Solution, solve
from hil.addons.identify.linearised import STEP
from hil.addons.identify.squeeze import SHARE_SIGMA, Squeeze, grip_of
from hil.addons.identify.windows import (
    GAINS,
    GYRO_BIAS,
    OFFSETS,
    SETTLING_BINS,
    TWIST,
    Floor,
    Parameter,
    Windows,
    cut,
    rolled,
    twists,
    variables_of,
)
from hil.core.model import RobotModel
from hil.core.plant_signals import POSE
from hil.core.types import WHEEL_NAMES
from hil.plant.start import Value
from hil.plant.window_stepper import WindowStepper

_WIDEST = 6.0
_SOFTEST = 2.0  # of the logarithm of the stiffness: softer rollers would be no rollers
_SMALL = 1e-3
_MOST_SLIP_WINDOWS = 60  # each step takes twenty times as long with slip
_NAMED_GAIN = 0.01
_BELIEVED = ("wheel_radius_m", "half_length_m", "half_width_m", "mass_kg", "inertia_kg_m2", "wheel_inertia_kg_m2",
             "friction_coefficient")  # fmt: skip
WINDOW_S = 1.0
_APART_S = 0.25
_SMOOTHED_S = 0.025


class Prediction(NamedTuple):
    """The error of the predicted position at the ends of windows of one second, root mean square over the windows.

    ``against`` is what it was measured against: "truth", or "wheels and gyro".
    """

    rms_m: float
    against: str


def predict(
    drive: Drive,
    robot: RobotModel,
    gyro_bias_rad_s: float,
    start: Mapping[str, Value],
    torque_constant_n_m_a: float,
) -> Prediction:
    """Predict a drive by our plant with these start values, from many starts.

    ``robot`` has the best known geometry. With it the wheels give the twist at the start of a window, and the measured
    pose in a recording without the truth.

    Raises BadInputError as ``WindowStepper``, DeviceError when the FMU fails.
    """
    rows = round(WINDOW_S / drive.period_s)
    margin = max(2, round(_SMOOTHED_S / drive.period_s))
    first = np.arange(margin, len(drive.time_s) - rows - margin, max(1, round(_APART_S / drive.period_s)))
    places = first[:, None] + np.arange(-margin, margin + 1)
    begin = twists(drive.speed_rad_s[places].mean(axis=1), robot)
    begin[:, 2] = drive.yaw_rate_rad_s[places].mean(axis=1) - gyro_bias_rad_s
    torque = drive.current_a[first[:, None] + 1 + np.arange(rows)] * torque_constant_n_m_a
    step_ns = round(drive.period_s * 1e9)
    with WindowStepper(plant_fmu.path(2), start, varied=TWIST, outputs=POSE, step_ns=step_ns) as stepper:
        ends = stepper.run(torque, np.arange(len(first)), begin)[:, -1]
    pose, against = drive.truth, "truth"
    if not drive.has_truth:
        pose, against = rolled(drive, robot, gyro_bias_rad_s), "wheels and gyro"
    moved = pose[first + rows] - pose[first]
    c, s = np.cos(pose[first, 2]), np.sin(pose[first, 2])
    x, y = c * moved[:, 0] + s * moved[:, 1], c * moved[:, 1] - s * moved[:, 0]
    square = (ends[:, 0] - x) ** 2 + (ends[:, 1] - y) ** 2
    return Prediction(float(np.sqrt(np.mean(square))), against)


class Fitted(NamedTuple):
    """One model, fitted.

    Attributes:
        contact: "rigid" or "slip".
        parameters: what was fitted, and last radius, lever and gyro's bias.
        solution: for the torque constant that is believed.
        held_out: how well it predicts the held-out drive.
        start: start values of the FMU with which it does so.
    """

    contact: str
    parameters: tuple[Parameter, ...]
    solution: Solution
    held_out: Prediction
    start: Mapping[str, Value]

    @property
    def values(self) -> dict[str, float]:
        """The fitted values by the parameters' names."""
        return _named(self.parameters, self.solution.parameters)


class Result(NamedTuple):
    """What a fit found.

    Attributes:
        robot: [robot] with the lengths that were found.
        torque_constant_n_m_a: the believed one, for which all values are.
        unknown: what the drives could not tell.
        kinematics, blocks: what was found before the dynamics.
        models: each model that was fitted; chosen: the one that predicts the held-out drive best.
        before: how well the believed values predict that drive.
        grip: from a squeeze; None without one, or where the wheels did not slide.
        notes: sentences on what a drive did not tell.
    """

    robot: RobotModel
    torque_constant_n_m_a: float
    unknown: tuple[Unknown, ...]
    kinematics: Kinematics
    blocks: BlocksFit | None
    models: tuple[Fitted, ...]
    chosen: Fitted
    before: Prediction
    grip: float | None
    notes: tuple[str, ...]


def fit(
    floor: Drive,
    held_out: Drive,
    *,
    blocks: Drive | None = None,
    contacts: Sequence[str] = ("rigid", "slip"),
    squeeze: Drive | None = None,
) -> Result:
    """Fit our plant to a drive on the floor, and to one on blocks if there is one.

    The values are for the torque constant of the drive's scenario; ``estimates`` scales them when the mass is weighed.
    ``squeeze`` is a drive in which the wheels slid against one another.

    Raises BadInputError for drives with too little information, a faulty robot or a floor that is not level.
    """
    for drive in (floor, held_out):
        check_motors(drive)
    check_excitation(floor)
    measured = quiet([floor] if blocks is None else [floor, blocks], held_out)
    floor, held_out = measured.drives[0], measured.drives[-1]
    believed = floor.robot
    torque_constant = float(floor.values["firmware.torque_constant_n_m_a"])
    kinematics = fit_kinematics(floor)
    robot = replace(believed, **with_geometry(believed, kinematics))
    on_blocks = None if blocks is None else fit_blocks(measured.drives[1], torque_constant)
    windows = cut(floor, robot)
    usual_a = np.sqrt(np.mean(floor.current_a**2, axis=0))
    known = Before(robot, torque_constant, kinematics, on_blocks, measured.gain_variance, usual_a)
    unknown = _prospect(known, windows)
    models: list[Fitted] = []
    notes: list[str] = [*measured.sentences]
    grip: float | None = None
    for contact in contacts:
        model = _fit_model(contact, floor, windows, known, models[0] if models else None, held_out)
        if contact == "slip" and squeeze is not None:
            # Friction has to be known without that of the rollers, so the model without slip does not do.
            model, (grip, sentence) = _squeezed(model, squeeze, known, held_out)
            notes.append(sentence)
        models.append(model)
    start = _shared("rigid") | {name: getattr(believed, name) for name in _BELIEVED}
    before = predict(held_out, robot, kinematics.gyro_bias_rad_s, start, torque_constant)
    chosen = min(models, key=lambda model: model.held_out.rms_m)
    gains = [chosen.values[one.name] for one in GAINS]
    if max(abs(gain - 1.0) for gain in gains) > _NAMED_GAIN:
        named = ", ".join(f"{wheel} {gain:.3f}" for wheel, gain in zip(WHEEL_NAMES, gains, strict=True))
        notes.append(f"the current sensors differ; true current over measured, against the mean of the four: {named}")
    return Result(
        _with_lengths(robot, chosen.start),
        torque_constant,
        unknown,
        kinematics,
        on_blocks,
        tuple(models),
        chosen,
        before,
        grip,
        tuple(notes),
    )


def _with_lengths(robot: RobotModel, found: Mapping[str, Any]) -> RobotModel:
    return replace(robot, **{name: float(found[name]) for name in ("half_length_m", "half_width_m")})


def _shared(contact: str) -> dict[str, Value]:
    return {"drive": "torque", "contact": contact, "longest_step_s": 0.01}


def _prospect(before: Before, windows: Windows) -> tuple[Unknown, ...]:
    """Return what the drive cannot tell. Raises BadInputError when that is too much."""
    parameters = before.parameters("rigid")
    point = before.point(parameters, {})
    with Floor(_shared("rigid"), parameters, windows, before.torque_constant_n_m_a) as floor:
        return outlook(floor, parameters, point, before.knowledge(parameters))


def _fit_model(
    contact: str, drive: Drive, windows: Windows, before: Before, simpler: Fitted | None, held_out: Drive
) -> Fitted:
    parameters = before.parameters(contact)
    point = before.point(parameters, {} if simpler is None else simpler.values)
    least, most = point - _WIDEST, point + _WIDEST
    if contact == "slip":
        windows = cut(drive, before.robot, settling_bins=SETTLING_BINS).thinned(_MOST_SLIP_WINDOWS)
        rollers, stiffness = ([one.name for one in parameters].index(name) for name in (ROLLERS, STIFFNESS))
        least[rollers] = STEP  # it is not negative, and derivatives look to both sides
        least[stiffness], most[stiffness] = point[stiffness] - _SOFTEST, point[stiffness] + _SOFTEST
    with Floor(_shared(contact), parameters, windows, before.torque_constant_n_m_a) as floor:
        solution = solve(floor, point, bounds=(least, most), known=before.knowledge(parameters))
        if simpler is None:
            left = floor.measured - floor.predict(solution.parameters[None], solution.starts[None])[0]
            check_level(drive, windows, left, before.robot)
    return _judged(contact, parameters, solution, before, held_out)


def _squeezed(model: Fitted, squeeze: Drive, before: Before, held_out: Drive) -> tuple[Fitted, Squeeze]:
    """Return a model with a squeeze's grip in place of the floor's, which hardly shows it, and that grip."""

    def found(numbers: Array) -> Squeeze:
        values = _named(model.parameters, numbers)
        robot = _with_lengths(before.robot, variables_of(model.parameters, numbers))
        return grip_of(_with_true_currents(squeeze, values), robot, values, before.torque_constant_n_m_a)

    numbers, covariance = model.solution.parameters.copy(), model.solution.covariance.copy()
    squeezed = found(numbers)
    if (grip := squeezed.grip) is None:
        return model, squeezed
    # Uncertainty of loads and friction makes the grip uncertain too.
    others = [found(numbers + row).grip or grip for row in np.eye(len(numbers)) * _SMALL]
    slopes = (np.array(others) - grip) / _SMALL
    place = [one.name for one in model.parameters].index("grip_coefficient")
    variance = SHARE_SIGMA**2 + slopes @ covariance @ slopes / grip**2
    numbers[place] = model.parameters[place].internal(grip)
    covariance[place], covariance[:, place] = 0.0, 0.0
    covariance[place, place] = variance
    solution = model.solution._replace(parameters=numbers, covariance=covariance)
    return _judged(model.contact, model.parameters, solution, before, held_out), squeezed


def _judged(
    contact: str, parameters: tuple[Parameter, ...], solution: Solution, before: Before, held_out: Drive
) -> Fitted:
    """Return a model with its start values and its error on the held-out drive."""
    found = variables_of(parameters, solution.parameters)
    start = _shared(contact) | {name: float(value) for name, value in found.items()}
    bias = float(GYRO_BIAS.value(solution.parameters[-1]))
    constant = before.torque_constant_n_m_a
    judge = _with_true_currents(held_out, _named(parameters, solution.parameters))
    prediction = predict(judge, before.robot, bias, start, constant)
    return Fitted(contact, parameters, solution, prediction, start)


def _named(parameters: Sequence[Parameter], numbers: Array) -> dict[str, float]:
    return {one.name: float(one.value(number)) for one, number in zip(parameters, numbers, strict=True)}


def _with_true_currents(drive: Drive, values: Mapping[str, float]) -> Drive:
    """Return a drive whose currents are corrected by the gains and offsets that were found."""
    gains, offsets = ([values[one.name] for one in ones] for ones in (GAINS, OFFSETS))
    return replace(drive, current_a=drive.current_a * gains + offsets)
