"""Values sent as means over the feedback period: currents, acceleration and battery, in the bits of binary32."""

import struct
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import codec
from firmware_protocol.generated import messages as m
from tests.support.bare_node import BareNode
from tests.support.examples import share_of_examples
from tests.support.wheel_rig import PARAMETERS

PERIOD = 19  # index of feedback_period_s
NO_NUMBER = float("nan")


def single(value: float) -> float:
    """Return the nearest binary32."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def mean(samples: Sequence[float]) -> float:
    """Return the mean as the page defines it: added one by one, and divided, each rounded to binary32.

    Both operations in binary64 and then rounded are those in binary32 (53 is more than twice 24).
    """
    total = 0.0
    for sample in samples:
        total = single(total + single(sample))
    return single(total / len(samples))


class Robot(BareNode):
    """A node whose sensors all say what follows from one value a tick."""

    def __init__(self, period_s: float = 0.005) -> None:
        super().__init__(changes=PARAMETERS | {"feedback_period_s": period_s})
        self._begun = False
        self.heard()

    def say(self, value: float) -> list[codec.Message]:
        """Begin the next tick; return what the robot tells."""
        self.sense.current_a = [value, -value, 0.5 * value, 1.0]
        self.sense.acceleration_m_s2 = [-value, 2.0 * value, 9.81]
        self.sense.battery_v, self.sense.battery_a = 24.0 + value, 3.0 * value
        self.sense.gyro_rad_s = [0.0, 0.0, value]
        if self._begun:
            self.lib.wheel_node_drive(self.node, self.drive)
        self._begun = True
        self.lib.wheel_node_sense(self.node, self.sense)
        return self.heard()


def told(values: Sequence[float], tick: int) -> dict[type, codec.Message]:
    """Return what the robot has to say of the samples of one feedback period."""
    stamp = tick & 0xFFFF
    return {
        m.Currents: m.Currents(mean(values), -mean(values), mean([0.5 * v for v in values]), 1.0),
        m.Accelerometer: m.Accelerometer(
            -mean(values), mean([2.0 * v for v in values]), mean([9.81] * len(values)), stamp
        ),
        m.Gyro: m.Gyro(0.0, 0.0, values[-1], stamp),
    }


def on_wire(message: codec.Message) -> bytes:
    return codec.encode(message).payload


numbers = st.floats(-12.0, 12.0, width=32)


@pytest.mark.proves("R-MEAN-1", "R-MEAN-2", "R-MEAN-3", "R-SNAP-8")
@share_of_examples(0.3)
@given(period=st.sampled_from([1, 2, 5, 7, 20, 50]), values=st.lists(numbers, min_size=51, max_size=120))
def test_each_is_the_mean_over_the_period_that_ends_with_the_snapshot(period: int, values: list[float]) -> None:
    node = Robot(period / 1000)
    for tick, value in enumerate(values):
        heard = {type(x): x for x in node.say(value)}
        if m.Currents not in heard:
            continue
        first = max(0, tick - period + 1)
        for kind, expected in told(values[first : tick + 1], tick).items():
            assert on_wire(heard[kind]) == on_wire(expected), (tick, kind)


@pytest.mark.proves("R-MEAN-3", "R-SNAP-2")
def test_the_first_snapshot_after_a_reset_and_a_period_of_one_millisecond_tell_the_instant() -> None:
    (first,) = (x for x in Robot(0.2).say(3.0) if isinstance(x, m.Currents))
    assert first.fl_a == 3.0
    node = Robot(0.001)
    for tick in range(11):
        heard = [x for x in node.say(0.25 * tick) if isinstance(x, m.Currents)]
        assert [x.fl_a for x in heard] == ([0.25 * tick] if tick % 5 == 0 else [])


@pytest.mark.proves("R-MEAN-3")
def test_the_longest_period_is_two_hundred_samples() -> None:
    node = Robot(0.2)
    values = [single(0.01 * tick) for tick in range(201)]
    *_, last = (node.say(value) for value in values)
    (currents,) = (x for x in last if isinstance(x, m.Currents))
    assert on_wire(currents) == on_wire(told(values[1:], 200)[m.Currents])


@pytest.mark.proves("R-MEAN-4", "R-SNAP-3")
@pytest.mark.parametrize("gone", [{1}, {1, 2, 3, 4}, {5}, {1, 5}])
def test_a_tick_without_a_number_is_left_out(gone: set[int]) -> None:
    node = Robot()
    values = [float(tick) for tick in range(11)]
    for tick, value in enumerate(values):
        heard = node.say(NO_NUMBER if tick in gone else value)
        currents = [x for x in heard if isinstance(x, m.Currents)]
        if tick == 5:
            rest = [v for n, v in enumerate(values) if 1 <= n <= 5 and n not in gone]
            expected = [] if 5 in gone else [told(rest, 5)[m.Currents]]
            assert [on_wire(x) for x in currents] == [on_wire(x) for x in expected]
    assert [x.fl_a for x in currents] == [8.0], "the next period knows nothing of it"


@pytest.mark.proves("R-MEAN-5")
def test_the_battery_is_told_as_the_mean_over_the_newest_period_that_has_ended() -> None:
    for period, last in ((5, range(96, 101)), (7, range(92, 99)), (200, range(1))):
        node = Robot(period / 1000)
        for tick in range(101):
            heard = node.say(0.125 * tick)
        (power,) = (x for x in heard if isinstance(x, m.Power))
        expected = m.Power(mean([24.0 + 0.125 * n for n in last]), mean([0.375 * n for n in last]))
        assert on_wire(power) == on_wire(expected), period


def test_a_battery_that_was_never_measured_is_not_told() -> None:
    """Its period of 200 ms had no number; the tick at which POWER is due has one."""
    node = Robot(0.2)
    for tick in range(201):
        heard = node.say(NO_NUMBER if tick < 100 else 1.0)
        kinds = {type(x) for x in heard}
        assert m.Power not in kinds or tick == 200
        assert m.Temperatures in kinds or tick not in (100, 200)
    assert m.Power in kinds


def test_a_period_that_is_changed_on_the_way_divides_by_what_was_added() -> None:
    node = Robot()
    for tick in range(7):
        node.say(float(tick))
    bits = int.from_bytes(struct.pack(">f", 0.010), "big")
    node.send(m.ParameterRequest(PERIOD, m.Operation.WRITE, 1, bits))
    assert [x.result for x in node.heard() if isinstance(x, m.ParameterResponse)] == [m.Result.OK]
    for tick in range(7, 11):
        heard = node.say(float(tick))
    (currents,) = (x for x in heard if isinstance(x, m.Currents))
    assert currents.fl_a == 8.0, "of ticks 6 to 10"
