"""``hil check`` and ``hil show``: a scenario is checked and printed without running it."""

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer
from typer import Argument

from hil.cli.options import Json, LinkUrl, Mode, RobotFile, ScenarioName, Seed, Sets, load_scenario
from hil.cli.output import print_result, rows, table
from hil.core.errors import apart

if TYPE_CHECKING:
    from hil.core.model import RobotModel
    from hil.references import Feasibility
    from hil.scenario import Scenario
    from hil.scenario.tables import FirmwareTable

_DELAY_S = 1.5e-3
"""A tick of 1 ms until the torque acts, and half a tick that it is held."""
LEAST_MARGIN_RAD = math.radians(3.0)
"""Below it only friction keeps the loop from a limit cycle; the defaults have 6 degrees."""


def check(
    scenarios: Annotated[list[str], Argument(metavar="SCENARIO", help="shipped names or paths to .toml files")],
    robot: RobotFile = None,
    mode: Mode = None,
    link: LinkUrl = None,
    seed: Seed = None,
    sets: Sets = None,
    as_json: Json = False,
) -> None:
    """Check scenarios without running them: their values, laws, FMU, and whether the robot can follow the reference."""
    from hil.judge.baselines import baseline_words
    from hil.runtime.assembly import check_scenario
    from hil.runtime.robots import check_plant
    from hil.scenario.baseline import without_baselines
    from hil.scenario.unreached import beyond_the_end, without_effect

    found, lines, feasible = [], [], True
    names = without_baselines(scenarios)
    for name in names:
        resolved = load_scenario(name, set=sets or [], robot=robot, mode=mode, link=link, seed=seed)
        feasibility = check_scenario(resolved)
        check_plant(resolved)
        late, unread = (
            [f"{resolved.provenance[key]}: {key}: {words}" for key, words in rows_of(resolved)]
            for rows_of in (beyond_the_end, without_effect)
        )
        feasible &= not feasibility.sentences and not late
        baseline = baseline_words(resolved)
        reference = {"kind": resolved.reference.kind, **feasibility.figures()}
        loop = _speed_loop(resolved)
        one = {"scenario": resolved.name, "reference": reference, "baseline": baseline, "speed_loop": loop}
        found.append(one | {"beyond_the_end": late, "without_effect": unread})
        lines += [name] if len(names) > 1 else []
        more = [*([("speed loop", loop)] if loop else []), ("baseline", baseline)]
        told = [("after the end", sentence) for sentence in late] + [("no effect", sentence) for sentence in unread]
        lines += rows([*_rows(feasibility), *told, *more])
    print_result(as_json, found[0] if len(names) == 1 else {"scenarios": found}, lines)
    raise typer.Exit(0 if feasible else 1)


def show(
    scenario: ScenarioName,
    robot: RobotFile = None,
    mode: Mode = None,
    link: LinkUrl = None,
    seed: Seed = None,
    sets: Sets = None,
    as_json: Json = False,
) -> None:
    """Print every value of a scenario and where it came from."""
    from hil.scenario import format_value
    from hil.scenario import resolved as resolved_values

    values = resolved_values(load_scenario(scenario, set=sets or [], robot=robot, mode=mode, link=link, seed=seed))
    found = {key: {"value": value, "from": where} for key, value, where in values}
    print_result(
        as_json,
        found,
        table([("key", "value", "from"), *((key, format_value(value), where) for key, value, where in values)]),
    )


def _rows(feasibility: "Feasibility") -> Iterator[tuple[str, str]]:
    """Yield the wheel speed and torque that a reference needs, and why it is not feasible, if it is not."""
    for label, needed in (("wheel speed", feasibility.speed), ("wheel torque", feasibility.torque)):
        most = f"at most {apart(needed.worst, needed.limit)} {needed.unit}, of wheel {needed.worst_wheel}"
        yield label, f"{most} at t = {needed.worst_s:.3g} s; the limit is {needed.limit:g} {needed.unit}"
    yield from (("not feasible", sentence) for sentence in feasibility.sentences)
    yield from (("note", sentence) for sentence in feasibility.notes)


def _speed_loop(scenario: "Scenario") -> str | None:
    """Return how near our firmware's speed loop is to a limit cycle; None where a scenario does not use it."""
    from hil.core.types import CommandMode
    from hil.drivers.registry import OUR_DRIVER

    if scenario.controller.mode is not CommandMode.SPEED or scenario.device.driver != OUR_DRIVER:
        return None
    margin = yaw_margin(scenario.robot, scenario.firmware)
    words = f"around yaw {math.degrees(margin.phase_rad):.1f}° of phase are left at {margin.crossover_rad_s:.0f} rad/s"
    if margin.phase_rad < LEAST_MARGIN_RAD:
        words += (
            "; only friction keeps it from a limit cycle: lower firmware.speed_ki_n_m_rad = "
            f"{scenario.firmware.speed_ki_n_m_rad:g}, or firmware.speed_kp_n_m_s_rad too"
        )
    return words


class Margin(NamedTuple):
    """Where our firmware's speed loop crosses over [rad/s], and how much phase is left there [rad]."""

    crossover_rad_s: float
    phase_rad: float


def yaw_margin(robot: "RobotModel", firmware: "FirmwareTable") -> Margin:
    """Return the margin around yaw, where a wheel has least to accelerate, from the gains and the robot alone.

    The open loop is (kp + ki / s) / (J s) · b² / (s + b)² · exp(-s 1.5 ms), with the filter's bandwidth b and
    J = r² (I + k L²) / (4 L²). Its gain falls with the frequency, so there is one crossover.
    """
    inertia = robot.effective_inertia_kg_m2 * (robot.wheel_radius_m / (2.0 * robot.lever_m)) ** 2
    kp, ki, band = firmware.speed_kp_n_m_s_rad, firmware.speed_ki_n_m_rad, firmware.tracking_bandwidth_rad_s

    def gain(w: float) -> float:
        return math.hypot(kp, ki / w) / (inertia * w * (1.0 + (w / band) ** 2))

    low, high = 1e-6, 1e6
    for _ in range(100):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if gain(middle) > 1.0 else (low, middle)
    phase = 0.5 * math.pi - math.atan2(ki, kp * low) - 2.0 * math.atan(low / band) - _DELAY_S * low
    return Margin(low, phase)
