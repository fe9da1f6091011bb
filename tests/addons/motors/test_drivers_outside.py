"""A maker's motors from another package: listed, its settings checked, and its emulated device driven in lockstep."""

import importlib
import re
from pathlib import Path

import pytest

from hil.cli.list import listing
from hil.core.errors import BadInputError
from hil.robot.driver_registry import driver_names, emulated
from hil.runtime.assembly import run_scenario
from hil.runtime.provenance import ingredients
from hil.scenario import Scenario, load
from tests.support.outside import outside_package

MOTORS = '''
    """Four motors on one frame each way: speeds [mrad/s] to them, speeds and counts back each millisecond."""

    from dataclasses import dataclass
    from struct import Struct
    from typing import Annotated

    from firmware_protocol.framing import Frame
    from hil.core.options import POSITIVE
    from hil.core.types import CommandMode
    from hil.addons.motors.emulated_motors import EmulatedMotors
    from hil.robot.driver import Capabilities, Dialect, Driver, Sample

    SPEEDS = Struct("<4h")


    @dataclass(frozen=True)
    class Settings:
        counts_per_rad_s: Annotated[float, POSITIVE] = 500.0


    class Tiny(Driver):
        def __init__(self, settings, robot):
            self._capabilities = Capabilities(1000.0, frozenset(), frozenset({CommandMode.SPEED}))
            self._per_rad_s = settings.counts_per_rad_s
            self._sample = None

        @property
        def identity(self):
            return None if self._sample is None else "four tiny motors"

        def arm(self, now_ns):
            self._is_armed = True
            return self.disarm()

        def command(self, speed_rad_s, torque_n_m, now_ns):
            return [Frame(0x10, SPEEDS.pack(*(round(speed * self._per_rad_s) for speed in speed_rad_s)))]

        def disarm(self):
            return [Frame(0x10, bytes(8))]

        def feed(self, frame, stamp_ns):
            if frame.id == 0x11 and len(frame.payload) == 8:
                speeds = SPEEDS.unpack(frame.payload)
                self._sample = Sample(stamp_ns, tuple(count / self._per_rad_s for count in speeds))

        @property
        def sample(self):
            return self._sample


    class EmulatedTiny(EmulatedMotors):
        made = []
        was_driving = False

        def power_on(self):
            self.made.append(self)
            self._per_rad_s = self.settings.counts_per_rad_s
            self._targets = (0.0, 0.0, 0.0, 0.0)

        @property
        def is_driving(self):
            return any(self._targets)

        def receive(self, frame):
            if frame.id == 0x10 and len(frame.payload) == 8:
                self._targets = tuple(count / self._per_rad_s for count in SPEEDS.unpack(frame.payload))

        def tick(self):
            self.was_driving = self.was_driving or self.is_driving
            self.send(Frame(0x11, SPEEDS.pack(*(round(speed * self._per_rad_s) for speed in self.speeds_rad_s))))
            return self.follow(self._targets)


    class Failing(Tiny):
        """Its member ``settings.fails`` raises from the 500th frame on."""

        def __init__(self, settings, robot):
            super().__init__(settings, robot)
            self._fails = settings.fails
            self._frames = 0

        def feed(self, frame, stamp_ns):
            self._frames += 1
            self._check("feed")
            super().feed(frame, stamp_ns)

        def command(self, *arguments):
            self._check("command")
            yield from super().command(*arguments)

        def disarm(self):
            self._check("disarm")
            return super().disarm()

        @property
        def sample(self):
            self._check("sample")
            return self._sample

        @property
        def errors(self):
            self._check("errors")
            return ()

        def _check(self, name):
            if name == self._fails and self._frames >= 500:
                raise KeyError("a defect")


    @dataclass(frozen=True)
    class FailingSettings(Settings):
        fails: str = ""


    FAILING = Dialect("failing motors", frozenset({"can"}), FailingSettings, Failing, f"{__name__}:EmulatedTiny")
    DIALECT = Dialect(
        "tiny motors", frozenset({"can"}), Settings, Tiny, f"{__name__}:EmulatedTiny"
    )
    NO_DIALECT = Tiny
    BROKEN = Dialect("broken", frozenset({"can"}), Settings, lambda settings, robot: 1 / 0, "nowhere:Nothing")
'''
POINTS = {
    "tiny": "outside_package:DIALECT",
    "failing": "outside_package:FAILING",
    "wrong": "outside_package:NO_DIALECT",
    "broken": "outside_package:BROKEN",
}


@pytest.fixture(autouse=True)
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    outside_package(tmp_path, monkeypatch, MOTORS, {"hil.drivers": POINTS | {"odrive": "outside_package:DIALECT"}})


def scenario(**changes: object) -> Scenario:
    wanted = {"loop.rate_hz": 200, "loop.duration_s": 2, "expect": [], "device.driver": "tiny"}
    speeds = {"controller.command": "speed", "controller.law": "profile", "controller.gains": {}}
    return load("paper_circle", mode="lockstep", link="memory:", set=wanted | speeds | changes)


def test_its_emulated_device_is_driven_in_lockstep() -> None:
    result = run_scenario(scenario())
    assert result.exit_code == 0, result
    assert run_scenario(scenario()).metrics["wire_sha256"] == result.metrics["wire_sha256"]
    assert "driver_sha256" in ingredients(scenario())
    reasons = result.metrics["link_statistics"]["reasons"]
    assert reasons["round_trip_ms"] == "no feedback said that a command of the run was in force"
    assert reasons["clock"] == "the robot answered no TIME_SYNC_REQUEST"


def test_its_settings_are_checked_as_ours() -> None:
    assert scenario(**{"device.motors.counts_per_rad_s": 250.0}).device.settings.counts_per_rad_s == 250.0
    with pytest.raises(BadInputError, match=r"device\.motors\.counts_per_rad_s.*greater than 0"):
        scenario(**{"device.motors.counts_per_rad_s": -1.0})
    with pytest.raises(BadInputError, match=r"device\.motors\.count_per_rad_s.*counts_per_rad_s"):
        scenario(**{"device.motors.count_per_rad_s": 1.0})


def test_it_is_listed_with_what_it_can_do_and_a_shipped_name_is_not_taken() -> None:
    columns, rows = listing("drivers")
    outside = {row[0]: dict(zip(columns, row, strict=True)) for row in rows if "(outside-package)" in row[-1]}
    assert outside["tiny"]["wires"] == "can"
    assert "a shipped one has this name" in outside["odrive"]["what"]
    assert "is no hil.robot.driver.Dialect" in outside["wrong"]["what"]
    assert "ZeroDivisionError" in outside["broken"]["what"]
    assert [name for name in driver_names() if name in POINTS] == sorted(POINTS)


@pytest.mark.parametrize(
    ("driver", "sentence"),
    [
        ("tinny", "expected the name of a driver.*tiny"),
        ("wrong", "is no hil.robot.driver.Dialect"),
        ("broken", "of the package outside-package: making the driver failed at .*ZeroDivisionError"),
    ],
)
def test_what_cannot_be_used_is_refused(driver: str, sentence: str) -> None:
    with pytest.raises(BadInputError, match=sentence):
        scenario(**{"device.driver": driver})


def test_an_emulated_device_that_is_not_there_is_refused() -> None:
    with pytest.raises(BadInputError, match="importing 'nowhere:Nothing' failed"):
        emulated("broken")


@pytest.mark.parametrize("member", ["feed", "command", "sample", "errors"])
def test_a_failure_during_a_run_names_the_package_and_stops_the_motors(member: str) -> None:
    result = run_scenario(scenario(**{"device.driver": "failing", "device.motors.fails": member}))
    assert result.exit_code == 3
    begin = f"device.driver = 'failing', of the package outside-package: {member} failed at "
    assert re.search(
        re.escape(begin) + r".*outside_package\.py:\d+ \(raise KeyError.*\): KeyError: 'a defect'", str(result.failure)
    )
    (motors,) = importlib.import_module("outside_package").EmulatedTiny.made
    assert motors.was_driving
    assert not motors.is_driving


def test_a_stop_that_fails_is_reported_as_not_sent() -> None:
    result = run_scenario(scenario(**{"device.driver": "failing", "device.motors.fails": "disarm"}))
    assert result.exit_code == 3
    assert re.search(r"the stop could not be sent.*outside-package: disarm failed at .*KeyError", str(result.failure))
