"""Declarations of drivers: ``hil list drivers``, and scenarios that ask for features that a maker lacks."""

from typing import Any

import pytest

from hil.cli.list import DRIVER_COLUMNS, listing
from hil.core.errors import BadInputError
from hil.core.types import CommandMode
from hil.robot.driver_registry import EXTENSIONS, driver_names
from hil.scenario import load
from hil.scenario.motor_checks import make_driver


def test_every_driver_is_listed_with_what_it_states() -> None:
    columns, rows = listing("drivers")
    assert columns == DRIVER_COLUMNS
    assert tuple(row[0] for row in rows) == driver_names()
    for row in rows:
        said = dict(zip(columns, row, strict=True))
        assert all(said.values())
        if said["driver"] in EXTENSIONS.ours and said["driver"] != "dbc":
            can = make_driver(load("circle_speed", set={"device.driver": said["driver"]})).capabilities
            assert set(said["sensors"].split(", ")) == can.sensors
            assert ("with torque" in said["commands"]) is can.adds_torque
            assert (said["commands"] == "velocity of the body") is can.is_twist


def test_a_watchdog_may_be_a_setting() -> None:
    stops = {"device.driver": "wheeltec", "device.motors.stops_on_silence": True}
    assert make_driver(load("circle_speed", set=stops)).capabilities.watchdog == "fixed"


MUTE = {"kind": "mute", "target": "TICK", "start_s": 1.0, "end_s": 1.1}
DROP = {"kind": "drop", "target": "WHEEL_COMMAND", "value": 1.0}
GYRO = {"kind": "gyro_bias", "value": 0.1}


@pytest.mark.parametrize(
    ("driver", "asked", "sentence"),
    [
        (
            "c620",
            {"fault": [DROP]},
            'fault.1.target = "WHEEL_COMMAND"; this message is of our firmware, not of RoboMaster C620',
        ),
        (
            "odrive",
            {"fault": [DROP | {"target": "command"}, MUTE]},
            'fault.2.target = "TICK"; this message is of our firmware',
        ),
        ("moteus", {"fault": [GYRO]}, 'fault.1.kind = "gyro_bias"; mjbots moteus as it is set up has no gyro'),
        ("c620", "robot.yaw_rate_rad_s", 'expect.1.signal = "robot.yaw_rate_rad_s"; RoboMaster C620'),
        ("moteus", "robot.acceleration_z_m_s2", "mjbots moteus as it is set up does not measure it"),
        ("moteus", "battery.current_a", "does not measure it; remove the row (`hil list drivers`"),
        ("rosmaster", "wheel.rl.current_a", "Yahboom Rosmaster as it is set up does not measure it"),
        ("wheeltec", "wheel.fl.temperature_degc", "WHEELTEC C50X as it is set up does not measure it"),
    ],
)
def test_what_a_maker_cannot_do_is_refused(driver: str, asked: Any, sentence: str) -> None:
    changes = asked if isinstance(asked, dict) else {"expect": [{"signal": asked, "below": 100.0}]}
    with pytest.raises(BadInputError) as refused:
        load("circle_speed", set={"device.driver": driver} | changes)
    assert sentence in str(refused.value)


@pytest.mark.parametrize(("driver", "signal"), [("odrive", "wheel.fl.temperature_degc"), ("vesc", "battery.current_a")])
def test_what_a_maker_can_do_is_not_refused(driver: str, signal: str) -> None:
    """Temperatures are told by firmware 0.6 of an ODrive, and before a run nobody knows which it is."""
    rows = {"fault": [DROP | {"target": "feedback"}], "expect": [{"signal": signal, "below": 100.0}]}
    load("circle_speed", set={"device.driver": driver} | rows)


def test_a_gyro_that_is_there_may_be_wrong() -> None:
    load("circle_speed", set={"device.driver": "rosmaster", "fault": [GYRO]})


@pytest.mark.parametrize("driver", [name for name in EXTENSIONS.ours if name != "dbc"])
def test_torques_that_would_be_dropped_are_warned_of(driver: str) -> None:
    made = make_driver(load("circle_speed", set={"device.driver": driver}))
    dropped = [warning for warning in made.warnings if "takes no torque beside a speed" in warning]
    assert len(dropped) == (not made.capabilities.adds_torque)
    if CommandMode.TORQUE in made.capabilities.modes:
        made = make_driver(load("paper_circle", set={"device.driver": driver, "controller.command": "torque"}))
        assert not any("takes no torque beside a speed" in warning for warning in made.warnings)
