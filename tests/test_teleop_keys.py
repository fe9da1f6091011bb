"""Properties of teleop's decoder of bytes, of its held keys and of its sticks."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.service.messages import Action
from hil.service.teleop.gamepad import Direction, Pad
from hil.service.teleop.keys import Attributes, Change, Event, Flags, Focus, Key, KeyDecoder
from hil.service.teleop.operator import KEYS, Heartbeat, HeldKeys, Operator, Speeds, Wish, of_keys, of_sticks, twist_of

SPEEDS = Speeds(0.5, 1.0)
KEY = st.sampled_from(sorted(KEYS))
SHARE = st.floats(-1.0, 1.0)
STICKS = st.builds(Direction, SHARE, SHARE, SHARE)


def operator_of(expo: float) -> Operator:
    return Operator(HeldKeys(reports_releases=True), SPEEDS, 0.1, expo)


# As the terminals' documents have them: xterm's control sequences, and kitty's keyboard protocol.
SEQUENCES = {
    b"i": Key("i"),
    b"I": Key("i"),
    b"\r": Key("enter"),
    b"\x04": Key("d", ctrl=True),
    b"\x1bi": Key("i", other=True),
    b"\x1b[A": Key("up"),
    b"\x1bOD": Key("left"),
    b"\x1b[1;5C": Key("right", ctrl=True),
    b"\x1b[1;1:3B": Key("down", Change.RELEASE),
    b"\x1b[105u": Key("i"),
    b"\x1b[105;1:2u": Key("i", Change.REPEAT),
    b"\x1b[105:73;2:3u": Key("i", Change.RELEASE),
    b"\x1b[99;5u": Key("c", ctrl=True),
    b"\x1b[105;129:1u": Key("i"),  # with Num Lock
    b"\x1b[105;3u": Key("i", other=True),
    b"\x1b[27;1:1u": Key("escape"),
    b"\x1b[?11u": Flags(11),
    b"\x1b[?62;22c": Attributes(),
    b"\x1b[O": Focus(False),
}
# Function keys, a mouse, a character and a key that are none of ours, an answer and an event in other words.
NOTHING = (b"\x1b[15~", b"\x1b[<0;3;4M", b"\xc3\xa4", b"\x1b[57441u", b"\x1b[?;u", b"\x1b[105;1:9u")
PIECES = st.lists(st.sampled_from([*SEQUENCES, *NOTHING]), max_size=8)


@given(PIECES, st.data())
def test_events_are_the_same_however_the_bytes_are_cut(pieces: list[bytes], data: st.DataObject) -> None:
    bytes_ = b"".join(pieces)
    decoder, events = KeyDecoder(), list[Event]()
    while bytes_:
        taken = data.draw(st.integers(1, 40))
        events += decoder.feed(bytes_[:taken])
        bytes_ = bytes_[taken:]
    assert events == [SEQUENCES[piece] for piece in pieces if piece in SEQUENCES]
    assert not decoder.waits


@given(st.binary(max_size=200))
def test_no_bytes_upset_the_decoder_and_the_next_key_is_heard(noise: bytes) -> None:
    decoder = KeyDecoder()
    decoder.feed(noise)
    if decoder.waits:
        assert decoder.settle() == [Key("escape")]
    assert decoder.feed(b"k") == [Key("k")]


def test_a_sequence_without_end_is_the_esc_key_and_a_number_without_end_is_nothing() -> None:
    digits = b"\x1b[" + b"9" * 5000
    assert KeyDecoder().feed(digits + b"u") == []
    assert KeyDecoder().feed(digits)[0] == Key("escape")


@given(st.lists(st.tuples(KEY, st.sampled_from(Change))))
def test_with_reported_releases_the_held_keys_are_those_pressed_and_not_released(
    changes: list[tuple[str, Change]],
) -> None:
    keys = HeldKeys(reports_releases=True)
    for name, change in changes:
        keys.on_key(Key(name, change), 0.0)
    last = {name: change for name, change in changes if change is not Change.REPEAT}
    assert keys.held(1e9)[0] == {name for name, change in last.items() if change is Change.PRESS}
    keys.release()
    for name in last:
        keys.on_key(Key(name, Change.REPEAT), 0.0)
    assert not keys.held(0.0)[0]


@given(st.lists(st.tuples(KEY, st.floats(0.001, 2.0)), min_size=1), st.floats(0.0, 2.0))
def test_a_repeated_key_is_held_alone_and_no_longer_than_its_limits(
    presses: list[tuple[str, float]], after_s: float
) -> None:
    keys, now_s = HeldKeys(reports_releases=False), 0.0
    for name, pause_s in presses:
        now_s += pause_s
        keys.on_key(Key(name), now_s)
    name, pause_s = presses[-1]
    is_repeat = keys.held(now_s)[1] == 1.0
    assert keys.held(now_s)[0] == {name}
    assert is_repeat <= (pause_s <= keys.FIRST_S and len(presses) > 1 and presses[-2][0] == name)
    limit_s = keys.REPEAT_S if is_repeat else keys.FIRST_S
    assert bool(keys.held(now_s + after_s)[0]) == (now_s + after_s <= now_s + limit_s)
    keys.release()
    assert not keys.held(now_s)[0]


def test_a_terminal_is_lost_when_a_query_is_not_answered_in_time() -> None:
    heartbeat = Heartbeat()
    assert [heartbeat.due(t_s) for t_s in (0.0, 0.05, 0.1)] == [True, False, True]
    assert not heartbeat.is_lost(0.3)
    assert heartbeat.is_lost(0.31), "other questions do not make up for the first"
    heartbeat.answered()
    assert not heartbeat.is_lost(0.31)


@given(st.lists(st.booleans()))
def test_a_button_counts_only_after_it_was_seen_released(pressed: list[bool]) -> None:
    operator, held = operator_of(0.5), list[bool]()
    for one in pressed:
        operator.on_pad(Pad(dead_man=one, estop=False, sticks=Direction(1.0, 0.0, 0.0)))
        held.append(operator.twist(0.0) is not None)
    assert held == [one and not all(pressed[:index]) for index, one in enumerate(pressed)]


@given(st.sets(KEY))
def test_keys_ask_for_at_most_the_speeds_and_opposite_keys_for_the_opposite(keys: set[str]) -> None:
    forward_m_s, left_m_s, yaw_rate_rad_s = twist_of(of_keys(keys), SPEEDS, 1.0)
    assert math.hypot(forward_m_s, left_m_s) <= SPEEDS.speed_m_s * (1 + 1e-12)
    assert abs(yaw_rate_rad_s) <= SPEEDS.yaw_rate_rad_s
    opposite = dict(
        zip(("up", "left", "i", "j", "u", "o", "s"), ("down", "right", ",", "l", ".", "m", "f"), strict=True)
    )
    opposite |= {b: a for a, b in opposite.items()}
    assert of_keys({opposite[key] for key in keys}) == pytest.approx([-share for share in of_keys(keys)])


@given(STICKS, st.floats(0.0, 0.9), st.floats(0.0, 1.0))
def test_sticks_keep_their_direction_and_rest_in_the_dead_zone(
    sticks: Direction, dead_zone: float, expo: float
) -> None:
    forward, left, turn = of_sticks(sticks, dead_zone, expo)
    length = math.hypot(sticks.forward, sticks.left)
    assert math.hypot(forward, left) <= min(1.0, length) + 1e-9
    assert abs(turn) <= 1.0
    assert turn * sticks.turn >= 0.0
    assert forward * sticks.left == pytest.approx(left * sticks.forward, abs=1e-9)
    if length <= dead_zone:
        assert (forward, left) == (0.0, 0.0)
    whole = of_sticks(Direction(1.0, 0.0, -1.0), dead_zone, expo)
    assert whole == pytest.approx((1.0, 0.0, -1.0))


@given(st.tuples(SHARE, SHARE), st.floats(0.0, 0.9), st.floats(0.0, 1.0))
def test_more_stick_is_never_less_speed(shares: tuple[float, float], dead_zone: float, expo: float) -> None:
    low, high = sorted(shares)
    turns = [of_sticks(Direction(0.0, 0.0, share), dead_zone, expo).turn for share in (low, high)]
    assert turns[0] <= turns[1]


@given(st.lists(st.one_of(st.sampled_from("ae\rkdcq+-="), KEY), max_size=30))
def test_only_an_enter_right_after_an_a_arms(typed: list[str]) -> None:
    operator = operator_of(0.5)
    names = ["enter" if name == "\r" else name for name in typed]
    wishes = [operator.on_key(Key(name), 0.0) for name in names]
    arms = [index for index, wish in enumerate(wishes) if wish is Action.ARM]
    assert arms == [i for i in range(1, len(names)) if names[i - 1 : i + 1] == ["a", "enter"]]
    assert 0.0 < operator.speeds.speed_m_s <= SPEEDS.speed_m_s


@pytest.mark.parametrize(
    ("name", "ctrl", "wish"),
    [
        ("e", False, Action.ESTOP),
        ("space", False, Action.STOP),
        ("d", False, Action.DISARM),
        ("c", True, "quit"),
        ("i", False, None),
        ("c", False, None),
        ("enter", False, None),
    ],
)
def test_of_keys_read_too_late_only_those_that_stop_count(name: str, ctrl: bool, wish: Wish | None) -> None:
    operator = operator_of(0.5)
    operator.on_key(Key("i"), 0.0)
    operator.on_key(Key("a"), 0.0)
    assert operator.on_late_key(Key(name, ctrl=ctrl)) is wish
    assert operator.twist(0.0) is None
    assert operator.on_key(Key("enter"), 0.0) is None


@pytest.mark.parametrize("stop", ["space", "escape", "k", "e"])
def test_after_a_stop_everything_must_be_pressed_again(stop: str) -> None:
    operator = operator_of(0.5)
    pad = Pad(dead_man=True, estop=False, sticks=Direction(1.0, 0.0, 0.0))
    operator.on_pad(pad._replace(dead_man=False))
    operator.on_pad(pad)
    operator.on_key(Key("up"), 0.0)
    assert operator.twist(0.0) is not None
    assert operator.on_key(Key(stop), 0.0) is (Action.ESTOP if stop == "e" else Action.STOP)
    operator.on_key(Key("up", Change.REPEAT), 0.0)
    operator.on_pad(pad)
    assert operator.twist(0.0) is None


def test_a_lost_gamepad_and_its_emergency_stop_let_go() -> None:
    operator = operator_of(0.0)
    pad = Pad(dead_man=True, estop=False, sticks=Direction(1.0, 0.0, 0.0))
    operator.on_pad(pad)
    assert operator.twist(0.0) is None, "held before it was looked at"
    operator.on_pad(pad._replace(dead_man=False))
    operator.on_pad(pad)
    assert operator.twist(0.0) == (0.5, 0.0, 0.0)
    operator.on_pad(None)
    assert operator.twist(0.0) is None
    operator.on_pad(pad)
    assert operator.twist(0.0) is None, "held when it came back"
    assert operator.on_pad(pad._replace(estop=True)) is Action.ESTOP
    assert operator.on_pad(pad._replace(estop=True)) is None, "once a press"
