"""The driver of a robot with third-party motor controllers, and what these cannot do that a scenario asks for."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from hil.core.types import WHEEL_NAMES
from hil.core.wheel_map import IMU_AXES
from hil.faults.kinds import MESSAGES, find
from hil.robot import driver_registry as registry
from hil.robot.driver_registry import dialect
from hil.scenario.tables import Tables
from hil.wire.url import parse_link

if TYPE_CHECKING:
    from hil.robot.driver_registry import Driver

_WIRES = {
    "can": "a CAN bus: can:INTERFACE/CHANNEL, or memory: within one process",
    "can_fd": "a CAN FD bus: can:INTERFACE/CHANNEL?fd=1&data_bitrate=5000000, or memory: within one process",
    "serial": "a serial line: serial:PATH?baud=115200, or memory: within one process",
}

_GUARDIAN_PERIODS = 3

_SENSOR_OF = {
    **{f"wheel.{wheel}.current_a": "current" for wheel in WHEEL_NAMES},
    **{f"wheel.{wheel}.temperature_degc": "temperature" for wheel in WHEEL_NAMES},
    **{f"robot.acceleration_{axis}_m_s2": "accelerometer" for axis in "xyz"},
    "robot.yaw_rate_rad_s": "gyro",
    "battery.voltage_v": "battery_voltage",
    "battery.current_a": "battery_current",
}
"""The sensor behind each signal that not every robot measures."""
_NOISE_OF = {"gyro_": "gyro", "accelerometer_": "accelerometer"}
"""The sensor of the plant's parameters that begin so: its noise and bias."""


def make_driver(tables: Tables) -> "Driver":
    """Make the driver. Raises BadInputError for settings that it refuses."""
    robot, firmware, device = tables.robot, tables.firmware, tables.device
    made = dialect(device.driver)
    facts = made.facts(
        robot.wheel_radius_m,
        robot.half_length_m + robot.half_width_m,
        tuple(WHEEL_NAMES.index(wheel) for wheel in device.wheels),
        tuple(-1 if wheel in device.reversed else 1 for wheel in device.wheels),
        min(robot.torque_limit_n_m, firmware.torque_limit_n_m),
        robot.speed_limit_rad_s,
        firmware.torque_constant_n_m_a,
        firmware.watchdog_s,
        tables.loop.period_ns * 1e-9,
        tables.controller.mode,
        made.wire_of(parse_link(tables.link.url).wire),
        robot.effective_inertia_kg_m2 / (robot.lever_m**2 * robot.effective_mass_kg),
    )
    return registry.make_driver(device.driver, device.settings, facts)


def contradictions(tables: Tables) -> Iterator[tuple[str, str]]:
    """Yield key and message for everything in the scenario that the motor controllers cannot do."""
    device, made = tables.device, dialect(tables.device.driver)
    title, wires = made.title, made.wires
    if made.wire_of(parse_link(tables.link.url).wire) not in wires:
        yield "link.url", f"expected for {title} {' or '.join(_WIRES[wire] for wire in sorted(wires))}"
    if device.guardian_s * tables.loop.rate_hz < _GUARDIAN_PERIODS:
        periods = f"{_GUARDIAN_PERIODS} command periods of {1.0 / tables.loop.rate_hz:g} s"
        words = f"expected at least {periods}, or a command that is a little late would be taken for silence"
        yield "device.guardian_s", words
    can = make_driver(tables).capabilities
    if tables.controller.mode not in can.modes:
        able = " or ".join(f'"{mode.name.lower()}"' for mode in sorted(can.modes))
        yield "controller.command", f"{title} takes only {able}"
    if can.feedback_hz * tables.firmware.watchdog_s <= 1.0:
        gap = f"the {1.0 / can.feedback_hz:g} s between two feedbacks of {title}"
        yield "firmware.watchdog_s", f"expected more than {gap}, or the robot would always be held"
    for begins, sensor in _NOISE_OF.items():
        for name, value in tables.plant.start.items() if sensor not in can.sensors else ():
            if name.startswith(begins) and value:
                yield f"plant.start.{name}", f"{title} as it is set up has no {sensor}; remove the row, or give 0"
    if device.imu != IMU_AXES and not can.sensors & {"gyro", "accelerometer"}:
        yield "device.imu", f"{title} as it is set up has no gyro and no accelerometer; remove the key"
    signals = {}
    for i, fault in enumerate(tables.fault, start=1):
        if fault.row.acts_on == "signal":
            signals[f"fault.{i}.target"] = fault.target
        if fault.row.acts_on == "link" and fault.target in MESSAGES:
            words = f'this message is of our firmware, not of {title}; take "command" or "feedback"'
            yield f"fault.{i}.target", words
        kind = find(fault.kind, fault.target)
        if kind.message:
            words = f"{kind.message} is a message of our firmware; {title} has none; take disconnect, or drop"
            yield f"fault.{i}.kind", words
        if kind.sensor and kind.sensor not in can.sensors:
            yield f"fault.{i}.kind", f"{title} as it is set up has no {kind.sensor} to act on; remove the row"
    for i, row in enumerate(tables.expect, start=1):
        signals |= {f"expect.{i}.{key}": name for key in ("signal", "of") if (name := getattr(row, key)) is not None}
    for key, signal in signals.items():
        if signal in _SENSOR_OF and _SENSOR_OF[signal] not in can.sensors:
            hint = "remove the row (`hil list drivers` shows who measures what)"
            yield key, f"{title} as it is set up does not measure it; {hint}"
