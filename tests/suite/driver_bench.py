"""A driver of another maker's motors alone: frames made by hand go in, and what it has measured comes out."""

import struct
from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from firmware_protocol.framing import Frame
from hil.core.types import CommandMode, FourWheels
from hil.robot.driver import Driver, Found, Probe, RobotFacts, Sample, Wire
from hil.robot.driver_registry import dialect, make_settings

MS = 1_000_000
ALL = (0, 1, 2, 3)
STILL: FourWheels = (0.0, 0.0, 0.0, 0.0)
SPEEDS: FourWheels = (1.0, -2.0, 3.0, -4.0)
TORQUES: FourWheels = (0.5, -1.0, 1.5, -2.0)
SPEED, TORQUE = CommandMode.SPEED, CommandMode.TORQUE
RADIUS_M, LEVER_M, LIMIT_N_M, N_M_A, WATCHDOG_S, PERIOD_S = 0.05, 0.3, 4.0, 0.5, 0.1, 0.01


def make(
    name: str,
    settings: Mapping[str, Any] | None = None,
    mode: CommandMode = SPEED,
    wire: Wire = "can",
    order: tuple[int, ...] = ALL,
) -> Driver:
    """Return a maker's driver for the robot of the numbers above, with settings as in ``[device.motors]``."""
    facts = RobotFacts(RADIUS_M, LEVER_M, order, (1, 1, 1, 1), LIMIT_N_M, 60.0, N_M_A, WATCHDOG_S, PERIOD_S, mode, wire)
    return dialect(name).make(make_settings(name, settings or {}, "device.motors"), facts)


def make_probe(name: str) -> Probe:
    """Return what finds a maker's motors on a bus."""
    make = dialect(name).probe
    assert make is not None
    return make()


def found_by(probe: Probe) -> Found:
    """Return a probe's result; it is not None."""
    found = probe.found()
    assert found is not None
    return found


def feed(driver: Driver, number: int, layout: str, *values: float, t_ms: float = 1.0) -> None:
    """Let the driver hear a frame with these values."""
    driver.feed(Frame(number, struct.pack(layout, *values)), round(t_ms * MS))


def sample_of(driver: Driver) -> Sample:
    """Return the driver's measurement; it is not None."""
    assert driver.sample is not None
    return driver.sample


def near(found: Sequence[float], expected: Sequence[float], within: float = 1e-9) -> None:
    """Assert that all numbers are the same but for rounding, or within a tolerance."""
    assert list(found) == pytest.approx(list(expected), rel=1e-6, abs=within, nan_ok=True)


def wheels(ahead: float, left: float, turn: float, radius_m: float = RADIUS_M, lever_m: float = LEVER_M) -> FourWheels:
    """Return the speeds of FL, FR, RR and RL for a twist in m/s and rad/s (equation 7 of the paper)."""
    sides = ((-1, -1), (1, 1), (-1, 1), (1, -1))  # of left and of turn
    a, b, c, d = ((ahead + y * left + w * lever_m * turn) / radius_m for y, w in sides)
    return a, b, c, d


def each_byte(data: bytes) -> list[bytes]:
    """Return the bytes one by one, as a slow line brings them."""
    return [data[at : at + 1] for at in range(len(data))]
