"""Makes the parts of a scenario's robot: its firmware or motor controllers, plant, wiring and protocol."""

import functools
from collections.abc import Collection, Mapping
from pathlib import Path

from firmware_protocol.built import BuildError
from firmware_protocol.host import HostNode, parameters
from hil.core.errors import BadInputError
from hil.core.link_protocol import WHEEL_DBC, LinkProtocol
from hil.core.options import plain
from hil.core.types import Pose
from hil.core.wheel_map import ImuMount, WheelMap, Wiring
from hil.estimation.estimators import EstimatorOptions
from hil.plant import archive
from hil.plant.description import check_start, check_units, read_description, variables_of
from hil.plant.mapping import Row, SignalMap, resolve
from hil.robot.driver_registry import dialect, emulated
from hil.robot.faults import Body
from hil.robot.virtual import MakeNode, VirtualPlant, VirtualRobot
from hil.scenario import SHIPPED_FMUS, DeviceTable, Scenario, StartValue
from hil.wire.link import DEFAULT_BAUD, LinkUrl
from hil.wire.url import parse_link

_NS = 1_000_000_000


def firmware_values(scenario: Scenario) -> dict[str, float]:
    """Return the firmware's parameters by the names of its own table.

    Raises BadInputError when the host library does not match its sources and cannot be rebuilt.
    """
    robot = scenario.robot
    size = {name: getattr(robot, name) for name in ("wheel_radius_m", "half_length_m", "half_width_m")}
    given = plain(scenario.firmware) | size | {"feedback_period_s": scenario.loop.period_ns / _NS}
    try:
        return {p.name: float(given[p.name]) for p in parameters()}
    except BuildError as error:
        raise BadInputError(str(error)) from error


def plant_start(scenario: Scenario, known: Collection[str]) -> dict[str, StartValue]:
    """Return the FMU's start values: those of [robot] and [firmware], overridden by [plant.start].

    ``known`` are the names of the FMU's parameters; values of [robot] and [firmware] for other names are left out,
    because a foreign FMU may lack them.
    """
    robot, firmware, start = scenario.robot, scenario.firmware, scenario.plant.start
    gear_ratio = start.get("gear_ratio")
    # The firmware's torque constant is at the wheel, the FMU's at the motor's shaft.
    turns = gear_ratio if isinstance(gear_ratio, float) and gear_ratio > 0.0 else 1.0
    believed = {
        "mass_kg": robot.mass_kg,
        "inertia_kg_m2": robot.inertia_kg_m2,
        "wheel_radius_m": robot.wheel_radius_m,
        "half_length_m": robot.half_length_m,
        "half_width_m": robot.half_width_m,
        "wheel_inertia_kg_m2": robot.wheel_inertia_kg_m2,
        "friction_coefficient": robot.friction_coefficient,
        "counts_per_revolution": float(firmware.counts_per_revolution),
        "motor_constant_n_m_a": firmware.torque_constant_n_m_a / turns,
        "motor_resistance_ohm": firmware.motor_resistance_ohm,
        "motor_inductance_h": firmware.motor_inductance_h,
    }
    return {name: value for name, value in believed.items() if name in known} | dict(start)


def check_plant_start(scenario: Scenario) -> None:
    """Raise BadInputError if the scenario's FMU rejects the start values; the FMU is not opened."""
    fmu = archive.locate(scenario.plant.fmu, scenario.directory)
    known = archive.read_header(fmu).parameters
    check_start(fmu, plant_start(scenario, known))
    _check_units(scenario, fmu, known)


def check_plant(scenario: Scenario) -> None:
    """Raise BadInputError if the scenario's own plant is no FMU, or has not what [plant] names; none of it is run."""
    if link_of(scenario).is_within_process:
        check_plant_start(scenario)
        fmu = archive.locate(scenario.plant.fmu, scenario.directory)
        description = read_description(fmu)
        units = {unit.name: unit for unit in description.unitDefinitions}
        resolve(signal_map(scenario), fmu, variables_of(description), units)


def _check_units(scenario: Scenario, fmu: Path, known: Collection[str]) -> None:
    passed_on = plant_start(scenario, known).keys() - scenario.plant.start.keys()
    names = passed_on - {"counts_per_revolution"}  # which may be a number or one a turn
    if names and not archive.is_ours(fmu):
        check_units(fmu, sorted(names))


def signal_map(scenario: Scenario) -> SignalMap:
    """Return [plant.map], with the constants that replace signals the FMU lacks."""
    firmware = scenario.firmware
    return SignalMap(
        {
            signal: Row(row.name, row.scale, row.offset, row.sign, row.unit)
            for signal, row in scenario.plant.map.items()
        },
        float(firmware.counts_per_revolution),
        firmware.torque_constant_n_m_a,
        scenario.plant.step_s,
    )


def start_pose(scenario: Scenario) -> Pose | None:
    """Return the start pose that the scenario gives.

    None if it gives none: a foreign FMU's own start pose is known only to the FMU.
    """
    given = [scenario.plant.start.get(f"start_{name}") for name in Pose._fields]
    if scenario.plant.fmu in SHIPPED_FMUS:
        given = [0.0 if value is None else value for value in given]
    numbers = [value for value in given if isinstance(value, float)]
    return Pose(*numbers) if len(numbers) == len(given) else None


def virtual_robot(scenario: Scenario) -> VirtualRobot:
    """Return the parts of the scenario's virtual robot. Raises BadInputError when its FMU is missing or not an FMU."""
    fmu = archive.locate(scenario.plant.fmu, scenario.directory)
    known = archive.read_header(fmu).parameters
    start = plant_start(scenario, known)
    _check_units(scenario, fmu, known)
    return VirtualRobot(
        VirtualPlant(fmu, start, signal_map(scenario), scenario.plant.timeout_s, scenario.plant.memory_limit_mb),
        firmware_values(scenario),
        scenario.loop.mode == "lockstep",
        _body(scenario, start, known),
    )


def _body(scenario: Scenario, start: Mapping[str, StartValue], known: Collection[str]) -> Body:
    robot = scenario.robot
    given = (start.get("half_length_m", robot.half_length_m), start.get("half_width_m", robot.half_width_m))
    half_length_m, half_width_m = (float(length) for length in given)
    is_rigid = "contact" in known and start.get("contact", "rigid") in ("rigid", 1.0)
    return Body(wiring(scenario), half_length_m, half_width_m, is_rigid)


def wheel_map(device: DeviceTable) -> WheelMap:
    return WheelMap(device.wheels, device.reversed)


def wiring(scenario: Scenario) -> Wiring:
    """Return how the virtual robot is wired: as [device] says, but for what [plant.wiring] has."""
    device, true = scenario.device, scenario.plant.wiring
    wheels = true.wheels or device.wheels
    motors = WheelMap(wheels, device.reversed if true.reversed is None else true.reversed)
    return Wiring(motors, true.encoders or wheels, true.encoders_reversed, ImuMount(true.imu or device.imu))


def protocol_of(device: DeviceTable) -> LinkProtocol:
    return LinkProtocol(dialect(device.driver).make_framing) if device.is_makers else WHEEL_DBC


def node_maker(device: DeviceTable) -> MakeNode:
    """Return a function that makes a virtual robot's firmware, or its motor controllers."""
    return functools.partial(emulated(device.driver), device.settings) if device.is_makers else HostNode


def link_of(scenario: Scenario) -> LinkUrl:
    """Return the scenario's link; a serial URL without a bit rate gets the one of the robot's motor controllers."""
    baud = dialect(scenario.device.driver).baud if scenario.device.is_makers else None
    return parse_link(scenario.link.url, baud=baud or DEFAULT_BAUD)


def needed_truth(estimator: EstimatorOptions) -> str | None:
    """Return the setting that needs the true pose; None if none does."""
    if estimator.source == "fused" and estimator.fix == "simulated":
        return 'estimator.fix = "simulated"'
    return 'estimator.source = "truth"' if estimator.source == "truth" else None


def no_lockstep(driver: str) -> BadInputError:
    """Return the error for lockstep with third-party motor controllers in another process."""
    return BadInputError(
        f"the protocol of {driver!r} has no STEP, so that its time cannot be advanced from outside; "
        "add --mode realtime, or run it within one process with --link memory:"
    )
