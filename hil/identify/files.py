"""The result of a fit as files: [robot] and [firmware] for --robot, and a plant that a scenario extends."""

import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hil.core.options import format_value
from hil.core.outputs import Existing, check_free, write_whole
from hil.identify.before import ROLLERS, STIFFNESS
from hil.identify.estimates import TORQUE_CONSTANT, Estimate
from hil.identify.fit import Result
from hil.identify.mapped import MappedFit
from hil.identify.recorded import Drive
from hil.scenario import Scenario

ROBOT_FILE = "robot.toml"
PLANT_FILE = "plant.toml"
FIGURES_FILE = "fit.json"
PICTURE = "held_out"
"""Name of the picture, without the ending of its format."""
_ROBOT = ("mass_kg", "inertia_kg_m2", "wheel_radius_m", "half_length_m", "half_width_m", "wheel_inertia_kg_m2",
          "friction_coefficient", "torque_limit_n_m", "speed_limit_rad_s")  # fmt: skip
_PLANT_ONLY = ("com_x_m", "com_y_m", "viscous_n_m_s_rad", "grip_coefficient", ROLLERS, STIFFNESS)
_COMMENT_COLUMN = 46


def check_files(folder: Path, kind: str, existing: Existing) -> None:
    """Raise BadInputError when a file of a result is there already and must not be replaced.

    ``kind`` is the format of the picture.
    """
    for name in (ROBOT_FILE, PLANT_FILE, FIGURES_FILE, f"{PICTURE}.{kind}"):
        check_free("file", folder / name, existing)


def robot_text(result: Result, found: Sequence[Estimate], made_from: Sequence[Drive]) -> str:
    """Return a robot's file: the tables that a robot of the first recording had, with what was found in them."""
    values, by_name = made_from[0].values, {one.name: one for one in found}
    lines = ["# A robot as it was identified. Runs any scenario on it: hil run SCENARIO --robot FILE"]
    lines += [f"# {line}" for line in provenance(result, made_from)]
    lines += ["", "[robot]"]
    for name in _ROBOT:
        if name in ("half_length_m", "half_width_m"):
            lever = by_name["lever_m"]
            lines.append(_line(name, getattr(result.robot, name), f"their sum {_interval(lever)}"))
        elif name in by_name:
            lines.append(_line(name, by_name[name].value, _words(by_name[name])))
        else:
            lines.append(_line(name, float(values[f"robot.{name}"]), "as it was"))
    for table in ("firmware", "device"):
        lines += ["", f"[{table}]", *_table(table, values, by_name.get(TORQUE_CONSTANT))]
    return "\n".join([*lines, ""])


def plant_text(result: Result, found: Sequence[Estimate], made_from: Sequence[Drive]) -> str:
    """Return a plant's file, which extends the robot's: what is true where the controller has no such number."""
    lines = [f"# The plant of {ROBOT_FILE}. A scenario begins with: extends = {format_value(PLANT_FILE)}"]
    lines += [f"# {line}" for line in provenance(result, made_from)]
    lines += ["", f"extends = {format_value(ROBOT_FILE)}", "", "[plant]", 'fmu = "mecanum"', "", "[plant.start]"]
    lines.append(_line("contact", result.chosen.contact, "predicts the held-out drive best"))
    lines.append(_line("drive", "current", "currents as they were measured"))
    lines += [_line(one.name, one.value, _words(one)) for one in found if one.name in _PLANT_ONLY]
    return "\n".join([*lines, ""])


def write_files(
    folder: Path, result: Result, found: Sequence[Estimate], made_from: Sequence[Drive], existing: Existing
) -> tuple[Path, Path]:
    """Write both files and return their paths. Raises BadInputError when one is there or cannot be written.

    ``made_from`` are all drives of the fit, that of the first scenario first.
    """
    for name in (ROBOT_FILE, PLANT_FILE):
        check_free("file", folder / name, existing)
    folder.mkdir(parents=True, exist_ok=True)
    robot, plant = folder / ROBOT_FILE, folder / PLANT_FILE
    write_whole(robot, robot_text(result, found, made_from).encode(), "file", existing)
    write_whole(plant, plant_text(result, found, made_from).encode(), "file", existing)
    return robot, plant


def write_figures(folder: Path, figures: Mapping[str, Any], existing: Existing) -> Path:
    """Write the figures of a fit as JSON beside its files, and return the path."""
    path = folder / FIGURES_FILE
    write_whole(path, (json.dumps(figures, indent=2) + "\n").encode(), "file", existing)
    return path


def write_mapped(
    path: Path, found: MappedFit, scenario: Scenario, made_from: Sequence[Drive], existing: Existing
) -> None:
    """Write a scenario that extends one and has the fitted start values of its FMU. Raises BadInputError as above."""
    base = scenario.name if scenario.path is None else os.path.relpath(scenario.path, path.resolve().parent)
    lines = [f"# Parameters of {scenario.plant.fmu}, as they were identified"]
    lines += [f"# Made by hil identify fmu, {datetime.now(UTC).isoformat(timespec='seconds')}."]
    before, after = found.before_rad_s, found.after_rad_s
    lines.append(f"# Held-out drive: wheel speeds {after:.3g} rad/s off, {before:.3g} before the fit (rms).")
    lines += [f"# {line}" for line in _recordings(made_from)]
    lines += ["", f"extends = {format_value(Path(base).as_posix())}", "", "[plant.start]"]
    lines += [_line(json.dumps(one.name), one.value, _words(one)) for one in found.estimates]
    write_whole(path, "\n".join([*lines, ""]).encode(), "file", existing)


def provenance(result: Result, made_from: Sequence[Drive]) -> Iterator[str]:
    """Yield when, by which model and from which recordings a result was made."""
    yield f"Made by hil identify fit, {datetime.now(UTC).isoformat(timespec='seconds')}."
    rms, before = 1e3 * result.chosen.held_out.rms_m, 1e3 * result.before.rms_m
    yield (
        f"Held-out drive: {rms:.3g} mm after a second, {before:.3g} mm before the fit, "
        f"against {result.chosen.held_out.against}."
    )
    yield from _recordings(made_from)


def _recordings(made_from: Sequence[Drive]) -> Iterator[str]:
    for drive in made_from:
        digest = hashlib.sha256(drive.path.read_bytes()).hexdigest()[:12] if drive.path.is_file() else "not there"
        yield f"From {drive.path.name}, SHA-256 {digest}."


def _table(table: str, values: Mapping[str, Any], torque_constant: Estimate | None) -> Iterator[str]:
    for key, value in values.items():
        name = key.removeprefix(f"{table}.")
        if name == key or value is None:
            continue
        if name == TORQUE_CONSTANT and torque_constant is not None:
            yield _line(name, torque_constant.value, _words(torque_constant))
        else:
            yield f"{name} = {format_value(value)}"


def _line(name: str, value: float | str, words: str) -> str:
    text = f"{name} = {format_value(float(f'{value:.6g}') if isinstance(value, float) else value)}"
    return f"{text:<{_COMMENT_COLUMN}} # {words}"


def _interval(one: Estimate) -> str:
    return f"{one.status}, 95 %: {one.low:.5g} to {one.high:.5g}"


def _words(one: Estimate) -> str:
    words = _interval(one) if one.low != one.high else one.status
    return f"{words}; {one.why}" if one.why else words
