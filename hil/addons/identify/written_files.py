"""The result of a fit as files: [robot] and [firmware] for --robot, and a plant that a scenario extends."""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hil.addons.identify.before import ROLLERS, STIFFNESS
from hil.addons.identify.drives import Drive
from hil.addons.identify.estimates import TORQUE_CONSTANT, Estimate
from hil.addons.identify.fit import Result
from hil.core.json_lines import json_safe
from hil.core.options import format_value
from hil.core.outputs import Existing, check_free, write_whole

ROBOT_FILE = "robot.toml"
PLANT_FILE = "plant.toml"
FIGURES_FILE = "fit.json"
_ROBOT = ("mass_kg", "inertia_kg_m2", "wheel_radius_m", "half_length_m", "half_width_m", "wheel_inertia_kg_m2",
          "friction_coefficient", "torque_limit_n_m", "speed_limit_rad_s")  # fmt: skip
_PLANT_ONLY = ("com_x_m", "com_y_m", "viscous_n_m_s_rad", "grip_coefficient", ROLLERS, STIFFNESS)
_COMMENT_COLUMN = 46


def check_files(folder: Path, existing: Existing) -> None:
    """Raise BadInputError when a file of a result is there already and must not be replaced."""
    for name in (ROBOT_FILE, PLANT_FILE, FIGURES_FILE):
        check_free("file", folder / name, existing)


def robot_text(result: Result, found: Sequence[Estimate], made_from: Sequence[Drive]) -> str:
    """Return a robot's file: the tables of the recorded robot, with the identified values."""
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
    """Return a plant's file, which extends the robot's: the parameters that only the plant has."""
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

    ``made_from`` are all drives of the fit, that on the floor first.
    """
    folder.mkdir(parents=True, exist_ok=True)
    robot, plant = folder / ROBOT_FILE, folder / PLANT_FILE
    write_whole(robot, robot_text(result, found, made_from).encode(), "file", existing)
    write_whole(plant, plant_text(result, found, made_from).encode(), "file", existing)
    return robot, plant


def write_figures(folder: Path, figures: Mapping[str, Any], existing: Existing) -> None:
    """Write the figures of a fit as JSON next to its files."""
    write_whole(folder / FIGURES_FILE, (json.dumps(json_safe(figures), indent=2) + "\n").encode(), "file", existing)


def provenance(result: Result, made_from: Sequence[Drive]) -> Iterator[str]:
    """Yield the time, the error on the held-out drive, and the recordings of a result."""
    yield f"Made by hil identify fit, {datetime.now(UTC).isoformat(timespec='seconds')}."
    rms, before = 1e3 * result.chosen.held_out.rms_m, 1e3 * result.before.rms_m
    yield (
        f"Held-out drive: {rms:.3g} mm after a second, {before:.3g} mm before the fit, "
        f"against {result.chosen.held_out.against}."
    )
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
