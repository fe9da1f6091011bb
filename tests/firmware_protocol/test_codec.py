"""The Python codec: against its laws, against cantools, and against the golden vectors."""

import math
from fractions import Fraction
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import codec
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages
from firmware_protocol.generated.messages import LENGTHS, MESSAGES, NAMES, WheelCommand
from tests.support.examples import share_of_examples
from tests.support.protocol_cases import (
    DBC,
    IDS,
    Limits,
    Vector,
    any_values,
    grid_values,
    limits,
    out_of_range_payloads,
    vectors,
)

by_id = pytest.mark.parametrize("number", IDS, ids=lambda n: DBC[n].name)


def build(number: int, values: dict[str, Any]) -> codec.Message:
    return MESSAGES[number](**values)


def test_the_tables_name_what_the_dbc_names() -> None:
    assert {n: m.name for n, m in DBC.items()} == NAMES
    assert {n: m.length for n, m in DBC.items()} == LENGTHS
    for number, kind in MESSAGES.items():
        assert number == kind.ID
        assert list(kind._fields) == [s.name for s in limits(number)]


@pytest.mark.parametrize(
    ("table", "message", "signal"),
    [
        (messages.Request, "HOST_HEARTBEAT", "request"),
        (messages.Mode, "STATUS", "mode"),
        (messages.State, "TICK", "state"),
        (messages.Fault, "STATUS", "fault"),
        (messages.StopReason, "STATUS", "stop_reason"),
        (messages.ArmRefusal, "STATUS", "arm_refusal"),
    ],
)
def test_the_enumerations_hold_the_value_tables(table: Any, message: str, signal: str) -> None:
    (dbc,) = (m for m in DBC.values() if m.name == message)
    choices = dbc.get_signal_by_name(signal).choices
    assert choices is not None
    assert {e.value: e.name for e in table} == {number: str(name) for number, name in choices.items()}


@by_id
@share_of_examples(0.4)
@given(data=st.data())
def test_on_the_grid_decode_inverts_encode(number: int, data: st.DataObject) -> None:
    message = build(number, data.draw(grid_values(number)))
    assert codec.decode(codec.encode(message)) == message


@pytest.mark.proves("R-GEN-10")
@by_id
@share_of_examples(0.4)
@given(data=st.data())
def test_off_the_grid_the_nearest_step_is_sent_halves_away_from_zero(number: int, data: st.DataObject) -> None:
    values = data.draw(any_values(number))
    decoded = codec.decode(codec.encode(build(number, values)))
    assert decoded is not None
    for s in limits(number):
        got = getattr(decoded, s.name)
        assert got == (nearest(values[s.name], s) if s.scaled else values[s.name])


def nearest(value: float, s: Limits) -> float:
    """Round by exact fractions: an oracle without floating point."""
    exact = Fraction(value) / Fraction(s.scale)
    raw = math.floor(abs(exact) + Fraction(1, 2))
    return math.copysign(raw, value) * s.scale


@pytest.mark.proves("R-GEN-10")
def test_halves_go_away_from_zero() -> None:
    step = 1 / 64
    below_half = math.nextafter(0.5 * step, 0.0)
    message = WheelCommand(0.5 * step, -0.5 * step, 1.5 * step, below_half, sequence=0, session=0)
    decoded = WheelCommand.decode(message.encode())
    assert decoded == (step, -step, 2 * step, 0.0, 0, 0)


@by_id
@share_of_examples(0.4)
@given(data=st.data())
def test_cantools_writes_and_reads_the_same_payload(number: int, data: st.DataObject) -> None:
    values = data.draw(grid_values(number))
    payload = build(number, values).encode()
    assert payload == DBC[number].encode(values, strict=True)
    assert DBC[number].decode(payload, decode_choices=False) == values


@by_id
def test_both_ends_of_every_range_agree_with_cantools(number: int) -> None:
    signals = limits(number)
    middle: dict[str, Any] = {s.name: s.raw_minimum if not s.scaled else 0.0 for s in signals}
    for s in signals:
        for raw in (s.raw_minimum, s.raw_maximum):
            values = middle | {s.name: raw * s.scale if s.scaled else raw}
            payload = build(number, values).encode()
            assert payload == DBC[number].encode(values, strict=True)
            assert codec.decode(Frame(number, payload)) == build(number, values)


@pytest.mark.proves("R-GEN-7")
@by_id
def test_beyond_each_range_encoding_names_message_field_value_and_range(number: int) -> None:
    signals = limits(number)
    good: dict[str, Any] = {s.name: s.raw_minimum * s.scale if s.scaled else s.raw_minimum for s in signals}
    for s in signals:
        low, high = s.raw_minimum * s.scale, s.raw_maximum * s.scale
        bad: list[Any] = [s.raw_minimum - 1, s.raw_maximum + 1]
        if s.scaled:
            bad = [
                math.nextafter(low, -math.inf),
                math.nextafter(high, math.inf),
                math.nan,
                math.inf,
                -math.inf,
            ]
        for value in bad:
            with pytest.raises(ValueError, match=f"{DBC[number].name}.{s.name} = ") as error:
                build(number, good | {s.name: value}).encode()
            assert str(value) in str(error.value)
            assert f"expected {low} to {high}" in str(error.value)


@by_id
def test_an_integer_field_takes_no_float(number: int) -> None:
    signals = limits(number)
    good: dict[str, Any] = {s.name: s.raw_minimum * s.scale if s.scaled else s.raw_minimum for s in signals}
    for s in signals:
        if not s.scaled:
            with pytest.raises(TypeError):
                build(number, good | {s.name: s.raw_minimum + 0.5}).encode()


@pytest.mark.proves("R-GEN-8")
@by_id
@share_of_examples(0.4)
@given(data=st.data())
def test_any_payload_is_refused_or_has_one_meaning(number: int, data: st.DataObject) -> None:
    payload = data.draw(st.binary(min_size=LENGTHS[number], max_size=LENGTHS[number]))
    frame = Frame(number, payload)
    message = codec.decode(frame)
    in_range = all(
        s.raw_minimum <= raw <= s.raw_maximum for s, raw in ((s, raw_value(number, s, payload)) for s in limits(number))
    )
    assert (message is not None) == in_range
    if message is None:
        assert codec.refusal(frame) == "range"
    else:
        assert codec.encode(message) == frame


@pytest.mark.proves("R-GEN-8")
@by_id
def test_a_raw_value_just_outside_its_limits_is_refused(number: int) -> None:
    for name, payload in out_of_range_payloads(number):
        assert codec.decode(Frame(number, payload)) is None, name
        assert codec.refusal(Frame(number, payload)) == "range"


def test_every_signal_with_a_limit_of_its_own_is_tried_outside_it() -> None:
    tried = {(DBC[n].name, name) for n in IDS for name, _ in out_of_range_payloads(n)}
    assert {("WHEEL_COMMAND", "rl_rad_s"), ("TICK", "state"), ("STEP", "substeps")} < tried
    assert ("ENCODERS", "fl_count") not in tried


def raw_value(number: int, s: Limits, payload: bytes) -> int:
    raw = DBC[number].decode(payload, decode_choices=False, scaling=False)
    assert isinstance(raw, dict)
    value = raw[s.name]
    assert isinstance(value, int)
    return value


@pytest.mark.proves("R-TRN-1")
@by_id
def test_another_length_is_refused_as_such(number: int) -> None:
    for length in range(12):
        if length != LENGTHS[number]:
            frame = Frame(number, b"\1" * length)
            assert codec.decode(frame) is None
            assert codec.refusal(frame) == "length"


@given(number=st.integers(0, 0xFFFF).filter(lambda n: n not in DBC), payload=st.binary(max_size=9))
def test_an_unknown_id_is_refused_as_such(number: int, payload: bytes) -> None:
    assert codec.decode(Frame(number, payload)) is None
    assert codec.refusal(Frame(number, payload)) == "unknown_id"


@pytest.mark.parametrize("vector", vectors(), ids=lambda v: f"{v.message.NAME}-{v.sequence}")
def test_golden_vectors(vector: Vector) -> None:
    assert codec.encode(vector.message) == vector.frame
    assert codec.decode(vector.frame) == vector.message


def test_the_golden_vectors_cover_every_message() -> None:
    assert {v.frame.id for v in vectors()} == set(IDS)
