"""Runs with the motor controllers of other makers: the emulated device of each in front of the plant, over its wire."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest

import hil
import hil.runtime.bench
import hil.runtime.robots
from firmware_protocol.framing import Frame
from firmware_protocol.generated.messages import State
from hil.addons.motors.c620.emulated_c620 import EmulatedC620
from hil.addons.service.messages import Phase
from hil.core.errors import BadInputError, DeviceError, LinkError
from hil.core.kinematics import BodyTwist
from hil.robot.driver import EXTENDED
from hil.robot.driver_registry import emulated
from hil.runtime.assembly import run_scenario
from hil.scenario import Scenario, load
from tests.support.dbc_mappings import motors
from tests.support.pilot_bench import PilotBench

BUS = "can:virtual/makers"
SPEED = {"controller.command": "speed", "controller.law": "profile", "controller.gains": {}}


def scenario(driver: str = "c620", link: str = BUS, **changes: Any) -> Scenario:
    short = {"loop.rate_hz": 200, "loop.duration_s": 3, "expect": [], "device.driver": driver}
    return load("paper_circle", mode="lockstep", link=link, set=short | changes)


@pytest.fixture
def built(monkeypatch: pytest.MonkeyPatch) -> Callable[[type[EmulatedC620]], None]:
    """Have the robots of the test made from another class."""
    return lambda kind: monkeypatch.setattr(hil.runtime.robots, "emulated", lambda _name: kind)


@pytest.fixture
def bystander() -> Iterator[can.BusABC]:
    """Another node on the bus, which hears all."""
    with can.Bus(interface="virtual", channel=BUS.rpartition("/")[2]) as bus:
        yield bus


def assert_off(bystander: can.BusABC) -> None:
    """The last currents that were commanded are none."""
    heard = iter(lambda: bystander.recv(0), None)
    last = [message for message in heard if message.arbitration_id == 0x200][-1]
    assert not any(last.data)


class MotorThreeFallsSilent(EmulatedC620):
    def send(self, frame: Frame) -> None:
        if frame.id != 0x203 or self.ticks < 1500:
            super().send(frame)


class MotorTwoGetsHot(EmulatedC620):
    def _sample(self, drive: Any) -> None:
        super()._sample(drive)
        if self.ticks > 1500:
            self.temperature_degc = (20.0, 120.0, 20.0, 20.0)


DBC = str(Path(hil.__file__).parent / "addons" / "motors" / "dbc" / "examples" / "wheel_drives.toml")
DRIVERS = [
    ("c620", {}, {}),
    ("c620", SPEED, {}),
    ("odrive", {}, {}),
    ("odrive", SPEED, {}),
    ("vesc", SPEED, {}),
    ("vesc", SPEED, {"link.url": "can:virtual/circle"}),
    ("moteus", SPEED, {}),
    ("moteus", {}, {"link.url": "can:virtual/circle?fd=1&data_bitrate=5000000"}),
    ("rosmaster", SPEED, {"plant.start.battery_voltage_v": 12.0}),
    ("wheeltec", SPEED, {}),
    ("wheeltec", SPEED, {"link.url": "can:virtual/circle"}),
]


@pytest.mark.parametrize(("driver", "command", "changes"), DRIVERS)
def test_the_papers_circle_is_tracked_through_each(
    driver: str, command: dict[str, Any], changes: dict[str, Any]
) -> None:
    result = run_scenario(scenario(driver, "memory:", **{"loop.duration_s": 8} | command | changes))
    assert result.failure is None
    assert result.metrics["steady_max_m"] < 0.006
    assert result.metrics["stopped"]


def test_the_papers_circle_is_tracked_through_a_device_of_the_users_own() -> None:
    changes = {"loop.rate_hz": 200, "loop.duration_s": 8, "expect": []} | SPEED
    result = run_scenario(load("paper_circle", robot=DBC, set=changes))
    assert result.failure is None
    assert result.metrics["steady_max_m"] < 0.006


@pytest.mark.parametrize(("driver", "battery_v"), [("vesc", 24.0), ("rosmaster", 12.0), ("wheeltec", 24.0)])
def test_in_lockstep_the_frames_are_the_same_however_a_line_hands_over_its_bytes(
    driver: str, battery_v: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A system gives what was written in parts of its own choice, here of 7 bytes at most."""
    pytest.importorskip("hil.wire.pty", reason="pseudo-terminals need a POSIX system")
    changes = SPEED | {"loop.duration_s": 0.3, "plant.start.battery_voltage_v": battery_v}

    def over(link: str) -> Any:
        return run_scenario(scenario(driver, link, **changes)).metrics["wire_sha256"]

    in_memory = over("memory:")
    assert over("serial:pty") == in_memory
    monkeypatch.setattr("hil.wire.pty._CHUNK", 7)
    monkeypatch.setattr("hil.wire.serial_port._CHUNK", 7)
    assert over("serial:pty") == in_memory


def test_after_a_lost_link_the_filter_is_less_sure_of_makers_controllers() -> None:
    lost = {"kind": "disconnect", "start_s": 0.5, "end_s": 0.7}
    fixes = {"estimator.source": "fused", "estimator.simulated_fix.gap_start_s": 0.4}
    fixes |= {"estimator.simulated_fix.gap_end_s": 60.0}
    result = run_scenario(scenario("vesc", "memory:", **{"loop.rearm": True, "fault": [lost]} | SPEED | fixes))
    (recovery,) = result.metrics["recoveries"]
    t_s, sigma_rad = result.signals["loop.t_s"], result.signals["estimator.sigma_heading_rad"]
    assert sigma_rad[t_s < recovery["lost_s"]][-1] < 0.02
    assert sigma_rad[t_s > recovery["armed_s"]][0] > 0.2


def test_the_motors_are_off_at_the_end_of_a_run(bystander: Any) -> None:
    assert run_scenario(scenario(**{"loop.duration_s": 1})).failure is None
    assert_off(bystander)


def test_a_motor_that_falls_silent_makes_feedback_old_then_lost_and_all_stop(built: Any, bystander: Any) -> None:
    built(MotorThreeFallsSilent)
    result = run_scenario(scenario())
    assert isinstance(result.failure, LinkError)
    assert result.metrics["stale_ticks"] > 20
    assert_off(bystander)


def test_an_error_of_the_makers_is_told_and_stops_all(built: Any, bystander: Any) -> None:
    built(MotorTwoGetsHot)
    result = run_scenario(scenario())
    assert isinstance(result.failure, DeviceError)
    assert "it is FAULT because of this: motor 2 of wheel fr has 120 °C" in str(result.failure)
    assert_off(bystander)


def test_a_law_that_crashes_leaves_no_motor_on(bystander: Any, tmp_path: Any) -> None:
    law = tmp_path / "bad.py"
    law.write_text(
        "from hil.laws.profile import Profile\n\n\n"
        "class Bad(Profile):\n"
        "    def update(self, reference, state, applied, dt_s):\n"
        "        command = super().update(reference, state, applied, dt_s)\n"
        "        return command if reference.pose.y_m < 0.3 else 1 / 0\n"
    )
    result = run_scenario(scenario(**SPEED | {"controller.law": f"{law}:Bad"}))
    assert "division by zero" in str(result.failure)
    assert_off(bystander)


def test_without_leave_to_move_nothing_is_asked_of_real_motors() -> None:
    changes = {"device.driver": "c620", "estimator.source": "odometry"}
    loaded = load("paper_circle", mode="realtime", link="can:udp_multicast/239.74.163.77", set=changes)
    with hil.runtime.bench.Bench(loaded, None, allow_motion=False) as bench:
        with pytest.raises(BadInputError, match="real motors would move; add --allow-motion"):
            bench.connect()
        assert bench.device.sent == 0


def test_controllers_that_do_not_answer_are_named(built: Any) -> None:
    class OnlyTwo(EmulatedC620):
        def send(self, frame: Frame) -> None:
            if frame.id < 0x203:
                super().send(frame)

    built(OnlyTwo)
    with pytest.raises(DeviceError, match="no feedback of the motors 3, 4; check their power"):
        run_scenario(scenario())


def short(frame: Frame) -> Frame:
    return frame._replace(payload=frame.payload[: 5 if len(frame.payload) > 8 else -1])


def with_id(frame: Frame, change: int) -> Frame:
    return frame._replace(id=frame.id ^ change)


BASE = {**SPEED, "device.motors": motors("twist_base"), "robot.speed_limit_rad_s": 39.0}
FD = "can:virtual/makers?fd=1&data_bitrate=5000000"
UNFIT: list[tuple[str, str, dict[str, Any], Callable[[Frame], Frame], str]] = [
    ("c620", BUS, {}, short, r"no feedback of the motors 1, 2, 3, 4, but frames that do not fit: 7 bytes, expected 8 "
     r"\(\d+ of 0x201, 0x202, 0x203, 0x204\); correct the controllers' settings, or device.motors"),
    ("c620", BUS, {}, lambda one: with_id(one, 0x40), r"motors.ids\); other identifiers were received: 0x241, 0x242, "),
    ("odrive", BUS, {}, short, r"from the nodes 0, 1, 2, 3, but .*: 7 bytes, expected 8 \(\d+ of 0x.* and 12 more\)"),
    ("odrive", BUS, {}, lambda one: with_id(one, EXTENDED), r"29 bits, expected one of 11 \(\d+ of 0x00000000, 0x0"),
    ("vesc", BUS, SPEED, short, r"7 bytes, expected 8 \(\d+ of 0x00000901, "),
    ("moteus", FD, SPEED, short, r"from the moteus 1, 2, 3, 4, but .* bytes that are no answer of a moteus \(\d+ of"),
    ("wheeltec", BUS, SPEED, short, r"from a WHEELTEC base, but .*: 7 bytes, expected 8 \(\d+ of 0x101, 0x102,"),
    ("dbc", BUS, BASE, short, r"nothing received of BASE_MOTION \(0x18ff0200\), but frames that do not fit: 7 bytes, "
     r"and BASE_MOTION has 8 in the DBC \(\d+ of 0x18ff0200\), 7 bytes, and BASE_IMU"),
    ("dbc", BUS, BASE, lambda one: with_id(one, 0xFE), r"nothing received of BASE_MOTION \(0x18ff0200\); .*; other "
     r"identifiers were received: 0x18ff02fe, "),
]  # fmt: skip


@pytest.mark.parametrize(("driver", "link", "changes", "change", "sentence"), UNFIT)
def test_frames_that_arrive_and_do_not_fit_are_the_reason(
    built: Any, driver: str, link: str, changes: dict[str, Any], change: Callable[[Frame], Frame], sentence: str
) -> None:
    """What the devices send reaches the host over a bus, with another length or identifier than it should have."""
    kind: Any = emulated(driver)

    class Unfit(kind):  # type: ignore[misc]
        def send(self, frame: Frame) -> None:
            super().send(change(frame))

    built(Unfit)
    with pytest.raises(DeviceError, match=sentence):
        run_scenario(scenario(driver, link, **changes))


def test_bytes_that_arrive_and_are_no_frames_are_the_reason(built: Any) -> None:
    """As with another baud rate."""

    class Garbled(emulated("wheeltec")):  # type: ignore[misc]
        def take_bytes(self) -> bytes:
            return bytes(byte ^ 0x55 for byte in super().take_bytes())

    built(Garbled)
    with pytest.raises(DeviceError, match=r"at 1 Mbit/s; what arrived is no frame \(.*stray \d+"):
        run_scenario(scenario("wheeltec", "memory:", **SPEED))


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"link": "serial:pty"}, "expected for RoboMaster C620 and C610 a CAN bus"),
        ({"device.imu": ("-y", "x", "z")}, "C610 as it is set up has no gyro and no accelerometer"),
        ({"driver": "c260"}, "expected the name of a driver; did you mean 'c620'"),
        (
            {"device.motors.gear_ration": 3.0},
            "unknown key device.motors.gear_ration; did you mean 'device.motors.gear_ratio'",
        ),
        ({"device.motors.gear_ratio": -3.0}, "device.motors.gear_ratio = -3.0; expected a number of at least 0"),
        ({"driver": "stm32", "device.motors.gear_ratio": 3.0}, "only for third-party motor controllers"),
    ],
)
def test_what_the_motors_cannot_be_told_is_refused_with_the_scenario(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(BadInputError) as refused:
        scenario(**changes)
    assert sentence in str(refused.value)
    assert "device" in str(refused.value) or "link.url" in str(refused.value)


def test_a_fault_of_what_the_motors_do_not_measure_is_refused() -> None:
    row = {"kind": "bias", "target": "robot.yaw_rate_rad_s", "start_s": 1.0, "value": 0.1}
    with pytest.raises(BadInputError, match="RoboMaster C620 and C610 as it is set up does not measure it"):
        scenario(fault=[row])
    assert scenario("wheeltec", "memory:", **SPEED, fault=[row])


def test_of_an_unknown_driver_the_name_alone_is_refused() -> None:
    with pytest.raises(BadInputError) as refused:
        scenario("c260", **{"device.motors.gear_ratio": 3.0})
    assert "did you mean 'c620'" in str(refused.value)
    assert "belongs to" not in str(refused.value)


def test_a_pilot_arms_drives_stops_and_clears_an_estop() -> None:
    changes = {"device.driver": "c620", "link.url": BUS}
    with PilotBench(**changes).armed() as bench:
        bench.pilot.active().twist(BodyTwist(0.3, 0.0, 0.0))
        bench.run(0.15)
        assert bench.last("wheel.fl.speed_rad_s") > 0.5
        bench.pilot.estop()
        bench.run_until(Phase.ESTOP)
        bench.run(0.5)
        assert bench.last("robot.state") == State.ESTOP
        assert abs(bench.last("wheel.fl.speed_rad_s")) < 0.2
        bench.pilot.clear()
        bench.run_until(Phase.DISARMED)
        bench.pilot.arm()
        bench.run_until(Phase.ACTIVE)
        bench.pilot.disarm()
        bench.run_until(Phase.DISARMED)
        assert not bench.bench.local.robot.node.is_driving  # type: ignore[union-attr, attr-defined]


def test_a_device_and_a_host_must_speak_the_same() -> None:
    hashes = {
        load("circle_speed", set=changes).hash
        for changes in ({}, {"device.driver": "c620"}, {"device.driver": "c620", "device.motors.ids": [1, 2, 3, 5]})
    }
    assert len(hashes) == 3
    assert load("circle_speed", set={"device.driver": "stm32"}).hash in hashes
