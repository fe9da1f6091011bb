"""A driver and the emulated device of its dialect in front of the plant, without link, loop or clock between them."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from firmware_protocol.framing import Frame
from hil.core.options import build
from hil.core.types import CommandMode, FourWheels
from hil.plant import archive
from hil.plant.archive import read_header
from hil.plant.fmu import FmuPlant
from hil.robot.driver import Driver, RobotFacts, Sample, Wire
from hil.robot.driver_registry import dialect, emulated
from hil.runtime.robots import firmware_values, plant_start
from hil.scenario import load

TICK_NS = 1_000_000
STILL = (0.0, 0.0, 0.0, 0.0)


class Rig:
    """Robot of ``paper_circle`` with the motors of a dialect; time is its own, in ticks of 1 ms."""

    def __init__(
        self,
        name: str,
        settings: Mapping[str, Any] | None = None,
        *,
        mode: CommandMode = CommandMode.SPEED,
        period_ticks: int = 5,
        emulated_settings: Mapping[str, Any] | None = None,
        wire: Wire | None = None,
        turning_share: float = 1.0,
        **changes: Any,
    ) -> None:
        scenario = load("paper_circle", mode="lockstep", set=changes)
        made = dialect(name)
        fmu = archive.locate(scenario.plant.fmu, scenario.directory)
        robot, firmware = scenario.robot, scenario.firmware
        self.facts = RobotFacts(
            robot.wheel_radius_m,
            robot.half_length_m + robot.half_width_m,
            (0, 1, 2, 3),
            (1, 1, 1, 1),
            firmware.torque_limit_n_m,
            robot.speed_limit_rad_s,
            firmware.torque_constant_n_m_a,
            firmware.watchdog_s,
            period_ticks * 1e-3,
            mode,
            wire or ("serial" if made.make_framing else min(made.wires)),
            turning_share,
        )
        options = build(made.settings, settings or {}, "device.motors")
        self.driver: Driver = made.make(options, self.facts)
        self.plant = FmuPlant(fmu, plant_start(scenario, read_header(fmu).parameters))
        others = options if emulated_settings is None else build(made.settings, emulated_settings, "device.motors")
        self.node = emulated(name)(
            others, firmware_values(scenario), self.plant.exchange_address, self.plant.context_address
        )
        self.ours = made.make_framing() if made.make_framing and self.facts.wire == "serial" else None
        self.period_ticks = period_ticks
        self.sent: list[Frame] = []
        self.heard: list[Frame] = []
        self.now_ns = 0

    def step(self, frames: Sequence[Frame] = (), ticks: int | None = None) -> None:
        """Send frames, let a period pass, and receive the answers, each frame in its tick."""
        self.sent += frames
        for frame in frames:
            if self.ours is None:
                self.node.receive(frame)
            else:
                self.node.feed(self.ours.encode(frame))
        for _ in range(self.period_ticks if ticks is None else ticks):
            self.node.run(1)
            self.now_ns += TICK_NS
            for frame in self._said():
                self.heard.append(frame)
                self.driver.feed(frame, self.now_ns)

    def _said(self) -> Sequence[Frame]:
        if self.ours is None:
            return self.node.take_frames()
        return self.ours.feed(self.node.take_bytes())

    def greet(self, limit: int = 400) -> str:
        """Ask until all have said what they are."""
        for _ in range(limit):
            if (identity := self.driver.identity) is not None:
                return identity
            self.step(self.driver.ask())
        raise AssertionError(self.driver.missing)

    def arm(self, limit: int = 400) -> None:
        """Go the way to closed loop at standstill."""
        for _ in range(limit):
            if self.driver.is_armed:
                return
            self.step(self.driver.arm(self.now_ns))
        raise AssertionError(f"not armed: {list(self.driver.errors)}")

    def drive(self, seconds: float, command: Callable[[float], tuple[FourWheels, FourWheels]]) -> None:
        """Command speeds and torques as a function of time since now."""
        begin_ns = self.now_ns
        while (t_s := (self.now_ns - begin_ns) * 1e-9) < seconds:
            speed, torque = command(t_s)
            self.step(self.driver.command(speed, torque, self.now_ns))

    def speeds(self) -> FourWheels:
        """Return the true wheel speeds [rad/s]."""
        fl, fr, rr, rl = self.plant.wheel_speeds()
        return fl, fr, rr, rl

    def is_still(self) -> bool:
        """Tell whether no wheel turns."""
        return all(abs(speed) < 0.05 for speed in self.speeds())


def ramp_to(target: FourWheels, ramp_s: float = 0.5) -> Callable[[float], tuple[FourWheels, FourWheels]]:
    """Return a command that goes to speeds along a line."""

    def command(t_s: float) -> tuple[FourWheels, FourWheels]:
        share = min(t_s / ramp_s, 1.0)
        fl, fr, rr, rl = (share * speed for speed in target)
        return (fl, fr, rr, rl), STILL

    return command


def assert_told(rig: Rig, target: FourWheels, within: float) -> Sample:
    """See the wheels turn so, and the sample say so; return it."""
    sample = rig.driver.sample
    assert sample is not None
    assert_near(rig.speeds(), target, 0.1)
    assert_near(sample.speed_rad_s, rig.speeds(), within)
    return sample


def assert_position_follows(rig: Rig, target: FourWheels, within: float) -> None:
    """Drive on for half a second: the reported positions move that far."""
    begin = rig.driver.sample
    rig.drive(0.5, lambda _t: (target, STILL))
    end = rig.driver.sample
    assert begin is not None
    assert end is not None
    turned = [b - a for a, b in zip(begin.position_rad, end.position_rad, strict=True)]
    assert_near(turned, [0.5 * speed for speed in target], within)


def assert_near(found: Sequence[float], expected: Sequence[float], within: float) -> None:
    """Compare two sets of four numbers."""
    assert all(math.isclose(a, b, abs_tol=within) for a, b in zip(found, expected, strict=True)), (found, expected)
