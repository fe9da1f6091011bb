"""Fits a plant to drives: kinematics first, then dynamics, without slip and with it; a held-out drive chooses."""

import contextlib
import functools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

import plant_fmu
from hil.core.model import RobotModel
from hil.core.types import WHEEL_NAMES
from hil.identify.before import ROLLERS, STIFFNESS, Before
from hil.identify.blocks import BlocksFit, fit_blocks
from hil.identify.currents import quiet
from hil.identify.floor import GAINS, GYRO_BIAS, OFFSETS, Floor, Parameter, variables_of
from hil.identify.gauss_newton import Solution, inverted, solve
from hil.identify.held_out import Prediction, predict
from hil.identify.identifiability import Outlook, check_excitation, outlook
from hil.identify.kinematics import Kinematics, Tape, fit_kinematics, with_geometry
from hil.identify.linearised import STEP
from hil.identify.recorded import Array, Drive
from hil.identify.squeeze import Squeeze, grip_of
from hil.identify.trouble import check_level, check_motors
from hil.identify.windows import SETTLING_BINS, Windows, cut
from hil.plant.start import Value

_WIDEST = 6.0
_SOFTEST = 2.0  # of the logarithm of the stiffness: softer rollers would be no rollers
_SMALL = 1e-3
_MOST_SLIP_WINDOWS = 60
_NAMED_GAIN = 0.01
WITHOUT_BLOCKS = 2.5
"""By which intervals of what mass and wheels share are widened without wheels on blocks, measured on random robots."""


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


class Result(NamedTuple):
    """What a fit found.

    Attributes:
        believed: [robot] as it was before.
        robot: the same with the lengths that were found.
        torque_constant_n_m_a: the believed one, for which all values are.
        outlook: what the drives could tell.
        kinematics, blocks: what was found before the dynamics.
        models: each model that was fitted; chosen: the one that predicts the held-out drive best.
        before: how well that drive is predicted by what was believed.
        grip: from a squeeze, and its standard deviation; None without one, or where the wheels did not slide.
        notes: sentences on what a drive did not tell.
    """

    believed: RobotModel
    robot: RobotModel
    torque_constant_n_m_a: float
    outlook: Outlook
    kinematics: Kinematics
    blocks: BlocksFit | None
    models: tuple[Fitted, ...]
    chosen: Fitted
    before: Prediction
    grip: tuple[float, float] | None
    notes: tuple[str, ...]


def fit(
    floor: Sequence[Drive],
    held_out: Drive,
    *,
    blocks: Drive | None = None,
    tape: Tape | None = None,
    contacts: Sequence[str] = ("rigid", "slip"),
    squeeze: Drive | None = None,
) -> Result:
    """Fit our plant to drives on the floor, and on blocks if there are any.

    The values are for the torque constant of the first drive's scenario; ``estimates`` scales them when the mass is
    weighed. ``squeeze`` is a drive in which the wheels slid against one another.

    Raises BadInputError for drives that tell too little, or that show a robot or a floor that is not as it should be.
    """
    for drive in (*floor, held_out):
        check_motors(drive)
    for drive in floor:
        check_excitation(drive)
    measured = quiet([*floor, *([] if blocks is None else [blocks])], held_out)
    *floor, held_out = (*measured.drives[: len(floor)], measured.drives[-1])
    blocks = None if blocks is None else measured.drives[-2]
    first = floor[0]
    torque_constant = float(first.values["firmware.torque_constant_n_m_a"])
    kinematics = _joined([fit_kinematics(drive, tape if drive is first else None) for drive in floor])
    robot = replace(first.robot, **with_geometry(first.robot, kinematics))
    on_blocks = None if blocks is None else fit_blocks(blocks, torque_constant)
    windows = [cut(drive, robot) for drive in floor]
    usual_a = np.sqrt(np.mean(np.concatenate([drive.current_a for drive in floor]) ** 2, axis=0))
    known = Before(robot, torque_constant, kinematics, on_blocks, measured.gain_variance, usual_a)
    seen = _prospect(known, windows)
    models: list[Fitted] = []
    notes, grip = [*measured.sentences], None
    for contact in contacts:
        model = _fit_model(contact, floor, windows, known, models[0] if models else None, held_out)
        if contact == "slip" and squeeze is not None:
            # Friction has to be known without that of the rollers, so the model without slip does not do.
            model, grip, sentence = _squeezed(model, squeeze, known, held_out)
            notes.append(sentence)
        models.append(model)
    believed = _shared("rigid") | _geometry(first.robot)
    believed |= {name: getattr(first.robot, name) for name in ("mass_kg", "inertia_kg_m2", "wheel_inertia_kg_m2")}
    believed["friction_coefficient"] = first.robot.friction_coefficient
    fmu = plant_fmu.path(2)
    bias = kinematics.gyro_bias_rad_s
    prediction = predict(held_out, robot, bias, fmu, believed, torque_constant)
    chosen = min(models, key=lambda model: model.held_out.rms_m)
    gains = [values_of(chosen)[one.name] for one in GAINS]
    if max(abs(gain - 1.0) for gain in gains) > _NAMED_GAIN:
        named = ", ".join(f"{wheel} {gain:.3f}" for wheel, gain in zip(WHEEL_NAMES, gains, strict=True))
        notes.append(f"the current sensors differ; true current over measured, against the mean of the four: {named}")
    return Result(
        first.robot,
        _with_lengths(robot, chosen.start),
        torque_constant,
        seen,
        kinematics,
        on_blocks,
        tuple(models),
        chosen,
        prediction,
        grip,
        tuple(notes),
    )


def _joined(found: Sequence[Kinematics]) -> Kinematics:
    """Return the mean of what several drives say, weighted by its information."""
    best = [one for one in found if one.scale_known] or list(found)
    if len(best) == 1:
        return best[0]
    information = [inverted(one.covariance) for one in best]
    total = inverted(functools.reduce(np.add, information))
    logs = [np.log([one.radius_m, one.lever_m]) for one in best]
    radius, lever = np.exp(total @ sum(i @ log for i, log in zip(information, logs, strict=True)))
    return best[0]._replace(radius_m=float(radius), lever_m=float(lever), covariance=total)


def _with_lengths(robot: RobotModel, found: Mapping[str, Any]) -> RobotModel:
    return replace(robot, **{name: float(found[name]) for name in ("half_length_m", "half_width_m")})


def _geometry(robot: RobotModel) -> dict[str, Value]:
    return {name: getattr(robot, name) for name in ("wheel_radius_m", "half_length_m", "half_width_m")}


def _shared(contact: str) -> dict[str, Value]:
    return {"drive": "torque", "contact": contact, "longest_step_s": 0.01}


def _prospect(before: Before, windows: Sequence[Windows]) -> Outlook:
    """Return what the drives can tell. Raises BadInputError when that is not enough."""
    parameters = before.parameters("rigid")
    point = before.point(parameters, {})
    with contextlib.ExitStack() as opened:
        floors = _opened(before, "rigid", parameters, windows, opened)
        return outlook(floors, parameters, point, before.knowledge(parameters))


def _opened(
    before: Before,
    contact: str,
    parameters: Sequence[Parameter],
    windows: Sequence[Windows],
    opened: contextlib.ExitStack,
) -> list[Floor]:
    constant, shared = before.torque_constant_n_m_a, _shared(contact)
    return [opened.enter_context(Floor(plant_fmu.path(2), shared, parameters, one, constant)) for one in windows]


def _fit_model(
    contact: str,
    drives: Sequence[Drive],
    windows: Sequence[Windows],
    before: Before,
    simpler: Fitted | None,
    held_out: Drive,
) -> Fitted:
    parameters = before.parameters(contact)
    point = before.point(parameters, {} if simpler is None else values_of(simpler))
    known = before.knowledge(parameters)
    if contact == "slip":  # each step takes twenty times as long
        whole = (cut(drive, before.robot, settling_bins=SETTLING_BINS) for drive in drives)
        windows = [one.thinned(_MOST_SLIP_WINDOWS // len(drives)) for one in whole]
    with contextlib.ExitStack() as opened:
        floors = _opened(before, contact, parameters, windows, opened)
        least, most = point - _WIDEST, point + _WIDEST
        if contact == "slip":
            rollers, stiffness = ([one.name for one in parameters].index(name) for name in (ROLLERS, STIFFNESS))
            least[rollers] = STEP  # it is not negative, and derivatives look to both sides
            least[stiffness], most[stiffness] = point[stiffness] - _SOFTEST, point[stiffness] + _SOFTEST
        solution = solve(floors, point, bounds=(least, most), known=known)
        if simpler is None:
            for drive, one, seen, starts in zip(drives, windows, floors, solution.starts, strict=True):
                left = seen.measured - seen.predict(solution.parameters[None], starts[None])[0]
                check_level(drive, one, left, before.robot)
    return _judged(contact, parameters, solution, before, held_out)


def _squeezed(
    model: Fitted, squeeze: Drive, before: Before, held_out: Drive
) -> tuple[Fitted, tuple[float, float] | None, str]:
    """Return a model with a squeeze's grip in place of the floor's, which hardly shows it; the grip; and a sentence."""

    def found(numbers: Array) -> Squeeze:
        values = _named(model.parameters, numbers)
        robot = _with_lengths(before.robot, variables_of(model.parameters, numbers))
        return grip_of(_with_true_currents(squeeze, values), robot, values, before.torque_constant_n_m_a)

    numbers, covariance = model.solution.parameters.copy(), model.solution.covariance.copy()
    squeezed = found(numbers)
    if squeezed.grip is None:
        return model, None, squeezed.sentence
    value, sigma = squeezed.grip
    # What is not known of loads and friction is not known of the grip either.
    others = [found(numbers + row).grip or squeezed.grip for row in np.eye(len(numbers)) * _SMALL]
    slopes = (np.array([grip for grip, _ in others]) - value) / _SMALL
    sigma = float(np.sqrt(sigma**2 + slopes @ covariance @ slopes))
    place = [one.name for one in model.parameters].index("grip_coefficient")
    numbers[place] = model.parameters[place].internal(value)
    covariance[place], covariance[:, place] = 0.0, 0.0
    covariance[place, place] = (sigma / value) ** 2
    solution = model.solution._replace(parameters=numbers, covariance=covariance)
    return _judged(model.contact, model.parameters, solution, before, held_out), (value, sigma), squeezed.sentence


def _judged(
    contact: str, parameters: tuple[Parameter, ...], solution: Solution, before: Before, held_out: Drive
) -> Fitted:
    """Return a model with its start values and its error on the held-out drive."""
    found = variables_of(parameters, solution.parameters)
    start = _shared(contact) | {name: float(value) for name, value in found.items()}
    bias = float(GYRO_BIAS.value(solution.parameters[-1]))
    constant = before.torque_constant_n_m_a
    judge = _with_true_currents(held_out, _named(parameters, solution.parameters))
    prediction = predict(judge, before.robot, bias, plant_fmu.path(2), start, constant)
    return Fitted(contact, parameters, solution, prediction, start)


def values_of(model: Fitted) -> dict[str, float]:
    """Return the fitted values by the parameters' names."""
    return _named(model.parameters, model.solution.parameters)


def _named(parameters: Sequence[Parameter], numbers: Array) -> dict[str, float]:
    return {one.name: float(one.value(number)) for one, number in zip(parameters, numbers, strict=True)}


def _with_true_currents(drive: Drive, values: Mapping[str, float]) -> Drive:
    """Return a drive whose currents are corrected by the gains and offsets that were found."""
    gains, offsets = ([values[one.name] for one in ones] for ones in (GAINS, OFFSETS))
    return replace(drive, current_a=drive.current_a * gains + offsets)
