"""Each wrapper halves the one quantity that it names, on its side of the part, and passes all else."""

from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import pytest

from hil.addons.verify.mutation.change import Change
from hil.addons.verify.mutation.mutant import Mutant, _with_other_law
from hil.addons.verify.mutation.wrappers import PORTS
from hil.core.types import (
    Acceleration,
    Applied,
    CommandMode,
    Pose,
    PoseFix,
    Reference,
    State,
    Twist,
    WheelCommand,
    Wheels,
)
from hil.runtime.tick import TickParts
from hil.scenario import load

HALF = {"scale": 0.5}
STATE = State(Pose(1.0, 2.0, 3.0), Twist(4.0, 5.0, 6.0))
REFERENCE = Reference(Pose(7.0, 8.0, 9.0), Twist(10.0, 11.0, 12.0), Acceleration(13.0, 14.0, 15.0))
COMMAND = WheelCommand(CommandMode.SPEED, Wheels(1.0, 2.0, 3.0, 4.0), Wheels(5.0, 6.0, 7.0, 8.0))
FIX = PoseFix(2_000_000, Pose(1.0, 2.0, 3.0), Twist(4.0, 5.0, 6.0))


class Measured(NamedTuple):
    robot_time_ns: int = 2_000_000
    encoder_count: tuple[int, ...] = (2, 4, 6, 8)
    speed_rad_s: Wheels = Wheels(1.0, 2.0, 3.0, 4.0)
    current_a: Wheels = Wheels(5.0, 6.0, 7.0, 8.0)
    acceleration_m_s2: tuple[float, ...] = (1.0, 2.0, 9.0)
    yaw_rate_rad_s: float = 0.5
    command_sequence: int = 7


MEASURED = {
    "count": {"encoder_count": (1, 2, 3, 4)}, "speed": {"speed_rad_s": (0.5, 1.0, 1.5, 2.0)},
    "current": {"current_a": (2.5, 3.0, 3.5, 4.0)}, "acceleration": {"acceleration_m_s2": (0.5, 1.0, 4.5)},
    "yaw_rate": {"yaw_rate_rad_s": 0.25}, "time": {"robot_time_ns": 1_000_000},
}  # fmt: skip


def halved(row: Any, field: str) -> Any:
    """Return a tuple with one of its fields, which are tuples too, halved."""
    return row._replace(**{field: tuple(0.5 * value for value in getattr(row, field))})


def wrapped(port: str, of: str, part: object, change: dict[str, Any] | None = None) -> Any:
    return PORTS[port].wrapper(part, of, Change(PORTS[port].of[of], HALF if change is None else change))


@pytest.mark.parametrize("of", PORTS["law"].of)
def test_of_a_law_an_input_or_an_output_is_changed(of: str) -> None:
    given: list[Any] = []
    law = SimpleNamespace(update=lambda *inputs: (given.append(inputs), COMMAND)[1], reset=lambda *inputs: inputs)
    changed = wrapped("law", of, law)
    command = changed.update(REFERENCE, STATE, Applied(COMMAND, True, 0.016), 0.03)
    reference = halved(REFERENCE, of.removeprefix("reference_")) if of.startswith("reference_") else REFERENCE
    state = halved(STATE, of) if of in ("pose", "twist") else STATE
    latency_s, dt_s = 0.008 if of == "latency" else 0.016, 0.015 if of == "dt" else 0.03
    assert given == [(reference, state, Applied(COMMAND, True, latency_s), dt_s)]
    fields = {"speed": "speed_rad_s", "torque": "torque_n_m"}
    assert command == (halved(COMMAND, fields[of]) if of in fields else COMMAND)
    assert changed.reset(STATE, REFERENCE) == (STATE, REFERENCE)


@pytest.mark.parametrize(("of", "field"), [("speed", "speed_rad_s"), ("torque", "torque_n_m")])
def test_a_command_is_changed_after_the_guard_and_before_the_robot(of: str, field: str) -> None:
    guard = SimpleNamespace(apply=lambda command: (command, True))
    assert wrapped("guard", of, guard).apply(COMMAND) == (halved(COMMAND, field), True)
    sent: list[Any] = []
    robot = SimpleNamespace(send=lambda command: (sent.append(command), 9)[1], poll=Measured, feedback=Measured())
    device = wrapped("robot", f"command_{of}", robot)
    assert (device.send(COMMAND), sent) == (9, [halved(COMMAND, field)])
    assert device.poll() == device.feedback == Measured()


@pytest.mark.parametrize("of", MEASURED)
def test_a_measurement_is_changed_before_the_loop_or_before_the_estimator_alone(of: str) -> None:
    expected = Measured(**cast("dict[str, Any]", MEASURED[of]))
    sent: list[Any] = []
    robot = SimpleNamespace(poll=Measured, feedback=Measured(), send=lambda command: (sent.append(command), 9)[1])
    device = wrapped("robot", of, robot)
    assert device.poll() == device.feedback == expected
    assert (device.send(COMMAND), sent) == (9, [COMMAND])
    given: list[Any] = []
    estimator = SimpleNamespace(update=lambda *inputs: (given.append(inputs), STATE)[1])
    assert wrapped("estimator", of, estimator).update(Measured(), FIX, [1]) == STATE
    assert given == [(expected, FIX, [1])]


def test_each_snapshot_of_the_robot_passes_the_change_once() -> None:
    robot = SimpleNamespace(poll=lambda: None, feedback=Measured())
    device = wrapped("robot", "yaw_rate", robot, {"drift": 1.0})
    assert device.poll() is None
    assert [device.feedback.yaw_rate_rad_s for _ in range(3)] == [1.5, 1.5, 1.5]
    robot.feedback = Measured(command_sequence=8)
    assert device.feedback.yaw_rate_rad_s == 2.5
    robot.feedback = Measured(robot_time_ns=3_000_000, command_sequence=8)
    assert device.feedback.yaw_rate_rad_s == 3.5


@pytest.mark.parametrize("of", ["pose", "twist"])
def test_of_an_estimator_the_state_is_changed_where_there_is_one(of: str) -> None:
    given: list[Any] = []
    states = iter([None, STATE])
    estimator = SimpleNamespace(update=lambda *inputs: (given.append(inputs), next(states))[1])
    changed = wrapped("estimator", of, estimator)
    assert [changed.update(Measured(), None), changed.update(Measured(), FIX)] == [None, halved(STATE, of)]
    assert given == [(Measured(), None, ()), (Measured(), FIX, ())]


@pytest.mark.parametrize("of", ["pose", "twist", "acceleration"])
def test_a_reference_is_changed(of: str) -> None:
    assert wrapped("reference", of, SimpleNamespace(at=lambda _: REFERENCE)).at(1.0) == halved(REFERENCE, of)


def test_a_reference_is_that_of_another_time_but_none_before_the_start() -> None:
    reference = wrapped("reference", "time", SimpleNamespace(at=lambda t_s: t_s), {"offset": -1.0})
    assert [reference.at(t_s) for t_s in (0.0, 0.5, 1.0, 3.5)] == [0.0, 0.0, 0.0, 2.5]


@pytest.mark.parametrize("of", PORTS["truth"].of)
def test_a_true_pose_is_changed_once(of: str) -> None:
    fixes = iter([None, FIX, FIX, None, FIX._replace(time_ns=4_000_000)])
    truth = wrapped("truth", of, SimpleNamespace(poll=lambda: next(fixes)), {"scale": 0.5})
    found = [truth.poll() for _ in range(5)]
    first = FIX._replace(time_ns=1_000_000) if of == "time" else halved(FIX, of)
    assert found[:4] == [None, first, first, None]
    assert found[4] == first._replace(time_ns=2_000_000 if of == "time" else 4_000_000)
    drifting = wrapped("truth", "pose", SimpleNamespace(poll=lambda: FIX), {"drift": 1.0})
    assert [drifting.poll().pose.x_m for _ in range(2)] == [2.0, 2.0]


class Covariance(NamedTuple):
    xx: float = 1.0
    xy: float = 2.0
    xh: float = 3.0
    yy: float = 4.0
    yh: float = 5.0
    hh: float = 6.0


class Fix(NamedTuple):
    time_ns: int = 2_000_000
    pose: Pose = STATE.pose
    covariance: Covariance = Covariance()


@pytest.mark.parametrize("of", PORTS["fixes"].of)
def test_a_pose_fix_is_changed(of: str) -> None:
    given: list[Any] = []
    source = SimpleNamespace(poll=lambda *inputs: (given.append(inputs), [Fix()])[1])
    expected = Fix(time_ns=1_000_000) if of == "time" else halved(Fix(), of)
    assert wrapped("fixes", of, source).poll(5, FIX) == [expected]
    assert given == [(5, FIX)]


# Which part of a tick is wrapped


def ticks() -> TickParts:
    return TickParts(**{name: cast("Any", SimpleNamespace(name=name)) for name in TickParts._fields})


@pytest.mark.parametrize("port", PORTS)
def test_the_part_that_a_mutant_names_is_wrapped_and_no_other(port: str) -> None:
    parts, scenario = ticks(), load("circle_speed")
    of = next(iter(PORTS[port].of))
    found = Mutant("x", wrap={"port": port, "of": of, **HALF}).parts(scenario, parts)
    name = {"law": "controller", "robot": "device"}.get(port, port)
    assert {field for field in TickParts._fields if getattr(found, field) is not getattr(parts, field)} == {name}
    assert getattr(found, name).name == name
    assert isinstance(getattr(found, name), cast("type", PORTS[port].wrapper))
    for other in ("plant", "link"):
        assert Mutant("x", wrap={"port": other, "of": "duty", **HALF}).parts(scenario, parts) is parts
    without = parts._replace(truth=None)
    assert Mutant("x", wrap={"port": "truth", "of": "pose", **HALF}).parts(scenario, without) is without


def test_a_law_is_made_anew_with_other_gains_or_another_model() -> None:
    scenario = load("circle_speed", set={"controller.law": "dsc", "controller.gains": {"k1_1_s": 6.0}})
    gains = {"port": "law", "of": "gains", "k1_1_s": "*0.5", "no_such_gain": 7.0}
    changed = Mutant("x", wrap=gains).parts(scenario, ticks())
    assert changed.controller.gains[:3] == (3.0, 3.0, 3.0)
    default = _with_other_law(scenario, "gains", {"filter_s": "*2"}).controller.gains
    assert default == {"k1_1_s": 6.0, "filter_s": 2.0 * 0.0675}
    heavier = _with_other_law(scenario, "model", {"mass_kg": "*1.5", "wheel_radius_m": "+0.01"})
    assert heavier.robot.mass_kg == 1.5 * scenario.robot.mass_kg
    assert heavier.robot.wheel_radius_m == scenario.robot.wheel_radius_m + 0.01
    assert heavier.controller is scenario.controller
