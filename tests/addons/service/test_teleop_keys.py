"""Properties of teleop's keys and of its sticks."""

import math
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.addons.service.messages import Action
from hil.addons.service.teleop.gamepad import Direction, Pad
from hil.addons.service.teleop.operator import FIRST_S, FIRST_SHARE, KEYS, REPEAT_S, Operator, Speeds, Wish, of_sticks
from hil.addons.service.teleop.terminal import Terminal, keys_of
from hil.core.errors import BadInputError

SPEEDS = Speeds(0.5, 2.0)
KEY = st.sampled_from(sorted(KEYS))
SHARE = st.floats(-1.0, 1.0)
STICKS = st.builds(Direction, SHARE, SHARE, SHARE)

# As the terminals' documents have them; function keys, a mouse, and a character that is none of ours.
SEQUENCES = {
    b"i": "i",
    b"\r": "enter",
    b" ": "space",
    b"\x04": "ctrl-d",
    b"\x1b[A": "up",
    b"\x1bOD": "left",
}
NOTHING = (b"\x1b[15~", b"\x1b[1;5C", b"\x1b[<0;3;4M", b"\xc3\xa4", b"\x01")


@given(st.lists(st.sampled_from([*SEQUENCES, *NOTHING]), max_size=8))
def test_keys_are_found_in_what_a_terminal_sends(pieces: list[bytes]) -> None:
    assert keys_of(b"".join(pieces)) == [SEQUENCES[piece] for piece in pieces if piece in SEQUENCES]


@given(st.binary(max_size=200))
def test_no_bytes_upset_the_keys_and_an_esc_is_one_of_them(noise: bytes) -> None:
    keys_of(noise)
    assert keys_of(noise + b"\x1b")[-1] == "escape"


@pytest.mark.parametrize("cut", [b"\x1b", b"\x1b[", b"\x1b[1;5", b"\x1bi", b"\x1b "])
def test_a_sequence_that_is_cut_off_or_a_key_with_alt_drives_nothing_and_arms_nothing(cut: bytes) -> None:
    operator = Operator(SPEEDS)
    wishes = [operator.on_key(key, 0.0) for key in (*keys_of(cut), *keys_of(b"A"), "enter")]
    assert wishes[0] is Action.STOP
    assert Action.ARM not in wishes
    assert operator.twist(0.0) is None


@given(st.lists(st.tuples(KEY, st.floats(0.001, 2.0)), min_size=1), st.floats(0.0, 2.0))
def test_a_repeated_key_is_held_alone_and_no_longer_than_its_limits(
    presses: list[tuple[str, float]], after_s: float
) -> None:
    operator, now_s = Operator(SPEEDS), 0.0
    for name, pause_s in presses:
        now_s += pause_s
        operator.on_key(name, now_s)
    name, pause_s = presses[-1]
    twist, direction = operator.twist(now_s), KEYS[name]
    assert twist is not None
    full = (direction.forward * 0.5, direction.left * 0.5, direction.turn * 2.0)
    is_repeat = twist == pytest.approx(full)
    assert twist == pytest.approx(full if is_repeat else [FIRST_SHARE * one for one in full])
    assert is_repeat <= (pause_s <= FIRST_S and len(presses) > 1 and presses[-2][0] == name)
    limit_s = REPEAT_S if is_repeat else FIRST_S
    assert (operator.twist(now_s + after_s) is not None) == (now_s + after_s <= now_s + limit_s)
    operator.release()
    assert operator.twist(now_s) is None


@given(st.lists(st.booleans()))
def test_a_button_counts_only_after_it_was_seen_released(pressed: list[bool]) -> None:
    operator, held = Operator(SPEEDS), list[bool]()
    for one in pressed:
        operator.on_pad(Pad(dead_man=one, estop=False, sticks=Direction(1.0, 0.0, 0.0)))
        held.append(operator.twist(0.0) is not None)
    assert held == [one and not all(pressed[:index]) for index, one in enumerate(pressed)]


def test_every_key_asks_for_full_speed_and_opposite_keys_for_the_opposite() -> None:
    for a, b in zip(("up", "left", "i", "j", "u", "o", "s"), ("down", "right", ",", "l", ".", "m", "f"), strict=True):
        assert math.hypot(*KEYS[a]) == pytest.approx(1.0)
        assert KEYS[a] == pytest.approx([-share for share in KEYS[b]])


@given(STICKS)
def test_sticks_keep_their_direction_and_rest_in_the_dead_zone(sticks: Direction) -> None:
    forward, left, turn = of_sticks(sticks)
    length = math.hypot(sticks.forward, sticks.left)
    assert math.hypot(forward, left) <= min(1.0, length) + 1e-9
    assert abs(turn) <= 1.0
    assert turn * sticks.turn >= 0.0
    assert forward * sticks.left == pytest.approx(left * sticks.forward, abs=1e-9)
    if length <= 0.1:
        assert (forward, left) == (0.0, 0.0)
    assert of_sticks(Direction(1.0, 0.0, -1.0)) == pytest.approx((1.0, 0.0, -1.0))


@given(st.tuples(SHARE, SHARE))
def test_more_stick_is_never_less_speed(shares: tuple[float, float]) -> None:
    low, high = sorted(shares)
    turns = [of_sticks(Direction(0.0, 0.0, share)).turn for share in (low, high)]
    assert turns[0] <= turns[1]


@given(st.lists(st.one_of(st.sampled_from(["a", "e", "enter", "k", "d", "c", "q", "+", "=", "-"]), KEY), max_size=30))
def test_only_an_enter_right_after_an_a_arms(names: list[str]) -> None:
    operator = Operator(SPEEDS)
    wishes = [operator.on_key(name, 0.0) for name in names]
    arms = [index for index, wish in enumerate(wishes) if wish is Action.ARM]
    assert arms == [i for i in range(1, len(names)) if names[i - 1 : i + 1] == ["a", "enter"]]
    assert 0.0 < operator.speeds.speed_m_s <= SPEEDS.speed_m_s


@pytest.mark.parametrize(
    ("name", "wish"),
    [
        ("e", Action.ESTOP),
        ("space", Action.STOP),
        ("d", Action.DISARM),
        ("ctrl-d", "quit"),
        ("i", None),
        ("c", None),
        ("enter", None),
    ],
)
def test_of_keys_read_too_late_only_those_that_stop_count(name: str, wish: Wish | None) -> None:
    operator = Operator(SPEEDS)
    operator.on_key("i", 0.0)
    operator.on_key("a", 0.0)
    assert operator.on_late_key(name) is wish
    assert operator.twist(0.0) is None
    assert operator.on_key("enter", 0.0) is None


@pytest.mark.parametrize("stop", ["space", "escape", "k", "K", "e", "E"])
def test_after_a_stop_everything_must_be_pressed_again(stop: str) -> None:
    operator = Operator(SPEEDS)
    pad = Pad(dead_man=True, estop=False, sticks=Direction(1.0, 0.0, 0.0))
    operator.on_pad(pad._replace(dead_man=False))
    operator.on_pad(pad)
    operator.on_key("up", 0.0)
    assert operator.twist(0.0) is not None
    assert operator.on_key(stop, 0.0) is (Action.ESTOP if stop in "eE" else Action.STOP)
    operator.on_pad(pad)
    assert operator.twist(0.0) is None


def test_a_lost_gamepad_and_its_emergency_stop_let_go() -> None:
    operator = Operator(SPEEDS)
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


def test_the_keys_are_a_compass_with_forward_above_and_left_at_the_left() -> None:
    rows = ("uio", "j l", "m,.")
    for row, forward in zip(rows, (1.0, 0.0, -1.0), strict=True):
        for key, left in zip(row, (1.0, 0.0, -1.0), strict=True):
            if key != " ":
                length = math.hypot(forward, left)
                assert KEYS[key] == pytest.approx((forward / length, left / length, 0.0))
    assert [KEYS[key] for key in ("up", "down", "left", "right")] == [KEYS[key] for key in "i,jl"]
    assert (KEYS["s"], KEYS["f"]) == ((0.0, 0.0, 1.0), (0.0, 0.0, -1.0))


@pytest.mark.parametrize(
    ("sticks", "direction"),
    [
        ((0.1, 0.0, 0.1), (0.0, 0.0, 0.0)),
        ((0.55, 0.0, -0.55), (0.3125, 0.0, -0.3125)),  # half of the way: 0.5 · 0.5 + 0.5 · 0.125
        ((-0.33, 0.44, 0.28), (-0.6 * 0.3125, 0.8 * 0.3125, 0.104)),  # 0.2 of the way: 0.1 + 0.004
        ((0.6, -0.8, 1.0), (0.6, -0.8, 1.0)),
        ((1.0, 1.0, 0.0), (math.sqrt(0.5), math.sqrt(0.5), 0.0)),
    ],
)
def test_a_stick_is_finer_near_its_rest(sticks: tuple[float, ...], direction: tuple[float, ...]) -> None:
    assert of_sticks(Direction(*sticks)) == pytest.approx(direction)


def test_plus_and_minus_change_both_speeds_from_a_twentieth_up_to_the_full_ones() -> None:
    operator = Operator(SPEEDS)
    assert operator.speeds == SPEEDS
    operator.on_key("+", 0.0)
    assert operator.speeds == SPEEDS, "no faster than full"
    shares = [0.8, 0.64]
    for share in shares:
        operator.on_key("-", 0.0)
        assert operator.speeds == pytest.approx((share * 0.5, share * 2.0))
    operator.on_key("=", 0.0)
    assert operator.speeds == pytest.approx((0.8 * 0.5, 0.8 * 2.0))
    for _ in range(20):
        operator.on_key("-", 0.0)
    assert operator.speeds == pytest.approx((0.05 * 0.5, 0.05 * 2.0))
    operator.on_pad(Pad(dead_man=False, estop=False, sticks=Direction(0.0, 0.0, 0.0)))
    operator.on_pad(Pad(dead_man=True, estop=False, sticks=Direction(-1.0, 0.0, 1.0)))
    operator.on_key("i", 0.0)
    assert operator.twist(0.0) == pytest.approx((-0.025, 0.0, 0.1)), "the gamepad comes first, at its own share"


def test_which_key_wishes_what() -> None:
    wishes = {key: Operator(SPEEDS).on_key(key, 0.0) for key in (*"dcqekK", "ctrl-d", "space", "escape", "x")}
    stops = dict.fromkeys(("k", "K", "space", "escape"), Action.STOP)
    quits = dict.fromkeys(("q", "ctrl-d"), "quit")
    assert wishes == stops | quits | {"d": Action.DISARM, "c": Action.CLEAR, "e": Action.ESTOP, "x": None}


@pytest.mark.parametrize("of_pipe", ["stdin", "stdout"])
def test_a_pipe_for_keys_or_screen_is_refused(of_pipe: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        stream = SimpleNamespace(isatty=lambda name=name: name != of_pipe, fileno=lambda number=number: number)
        monkeypatch.setattr(f"sys.{name}", stream)
    with pytest.raises(BadInputError, match="teleop needs a terminal for keys and screen; start it in one"):
        Terminal()
