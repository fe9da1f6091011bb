"""The table of faults: allowed rows, refused rows, and that the list has all kinds."""

from pathlib import Path

import pytest

from hil.cli.list import listing
from hil.core.errors import BadInputError
from hil.core.options import format_value
from hil.faults.kinds import KINDS, Kind
from hil.faults.rows import FaultRow, generators
from hil.scenario import load
from tests.support.fault_runs import write


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: f"{kind.name} {kind.acts_on}")
def test_the_example_of_every_kind_loads(tmp_path, kind) -> None:
    row = load(str(write(tmp_path, [{"kind": kind.name, **kind.example}]))).fault[0].row
    assert (row.kind, row.acts_on) == (kind.name, kind.acts_on)
    assert row.start_ns < row.end_ns


@pytest.mark.parametrize("ms", [1001, 1003, 2049, 9999, 16_001])
def test_a_fault_begins_and_ends_at_its_nanosecond(tmp_path, ms) -> None:
    given = {"kind": "drop", "target": "command", "value": 0.5, "start_s": ms / 1000, "end_s": (ms + 7) / 1000}
    row = load(str(write(tmp_path, [given]))).fault[0].row
    assert (row.start_ns, row.end_ns) == (ms * 1_000_000, (ms + 7) * 1_000_000)


def test_the_list_has_every_kind() -> None:
    _, rows = listing("faults")
    assert [row[0] for row in rows] == [kind.name for kind in KINDS]


def in_words(kind: Kind) -> str:
    """Return name, place, marks, numbers with unit, range and default, and the page's example of a kind."""
    numbers = [
        f"{one.name} [{one.unit}] {one.range}" + ("" if one.default is None else f" ({one.default:g})")
        for one in (kind.value, *kind.further)
        if one is not None
    ]
    marks = [mark for mark in ("is_instant", "explains") if getattr(kind, mark)]
    example = ", ".join(f"{key} = {format_value(value)}" for key, value in kind.example.items())
    return " | ".join([kind.name, kind.acts_on, " ".join(marks), "; ".join(numbers), example])


def test_the_rows_that_scenarios_may_have_stay_as_they_are_kept() -> None:
    kept = (Path(__file__).parents[1] / "vectors" / "fault_kinds.txt").read_text(encoding="utf-8").splitlines()
    assert list(map(in_words, KINDS)) == kept


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: f"{kind.name} {kind.acts_on}")
def test_the_words_of_a_kind_are_a_sentence_and_what_is_counted(kind) -> None:
    assert kind.meaning[0].isupper()
    assert kind.meaning.endswith(".")
    assert not kind.counts.endswith(".")
    assert kind.counts.split()[0] in {
        "ESTOP", "attempts", "biases", "foreign", "frames", "milliseconds", "resets", "ticks",
    }  # fmt: skip
    assert kind.unit == ("-" if kind.value is None else kind.value.unit if kind.value.unit else kind.value.meaning)
    assert kind.unit != ""
    assert not kind.targets or "`" in kind.target_words or "any signal" in kind.target_words


@pytest.mark.parametrize(("kind", "at"), [("burst_loss", 0.8), ("jitter", 10.0), ("babble", 100_000.0)])
def test_a_number_at_its_bound_is_taken_and_one_beyond_it_is_not(tmp_path, kind, at) -> None:
    row = {"kind": kind, "target": "command", **({"burst_frames": 4.0} if kind == "burst_loss" else {})}
    load(str(write(tmp_path, [row | {"value": at}])))
    with pytest.raises(BadInputError, match=r"lose 0\.8;" if kind == "burst_loss" else "expected more than 0, at most"):
        load(str(write(tmp_path, [row | {"value": 1.01 * at}])))


def test_defaults_are_filled_in_and_shown(tmp_path) -> None:
    rows = [{"kind": "drop", "target": "command"}, {"kind": "burst_loss", "target": "feedback", "value": 0.1}]
    drop, burst, gone = load(str(write(tmp_path, [*rows, {"kind": "disconnect"}]))).fault
    assert (drop.value, burst.burst_frames, gone.target, gone.value) == (1.0, 5.0, "link", None)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ({"kind": "dorp", "target": "command"}, "kind = 'dorp' is not a kind of fault; did you mean 'drop'?"),
        ({"kind": "drop", "target": "comand"}, "did you mean 'command'?"),
        ({"kind": "drop"}, "target is missing"),
        ({"kind": "drop", "target": "?"}, "drop; expected command (to the robot), feedback (from it), or one message"),
        ({"kind": "dead_motor", "target": "?"}, "is not a target of dead_motor; known: fl, fr, rl, rr"),
        ({"kind": "override", "target": "robot.state", "value": 0.5}, "value = 0.5 is not a state of the firmware"),
        ({"kind": "mute", "target": "TIK"}, "did you mean 'TICK'?"),
        ({"kind": "mute", "target": "STEP"}, "is not a target of mute"),
        ({"kind": "mute", "target": "TICK", "value": 1.0}, "mute takes no value; remove it"),
        ({"kind": "drop", "target": "command", "value": 0.0}, "expected more than 0, at most 1"),
        ({"kind": "drop", "target": "command", "burst_frames": 3.0}, "drop takes no burst_frames"),
        ({"kind": "burst_loss", "target": "command"}, "value is missing"),
        ({"kind": "burst_loss", "target": "command", "value": 0.9}, "lower value, or raise burst_frames"),
        ({"kind": "delay", "target": "command", "value": 11.0}, "at most 10 s, the delay"),
        ({"kind": "drop", "target": "command", "start_s": 2.0, "end_s": 1.0}, "is not after start_s"),
        ({"kind": "reset", "target": "robot", "end_s": 1.0}, "has no end; remove end_s"),
        ({"kind": "dead_motor", "target": "front left"}, "is not a target of dead_motor"),
        ({"kind": "dead_motor", "target": "fll"}, "did you mean 'fl'?"),
        ({"kind": "slip_patch", "value": 0.2, "x_m": 1.0}, "x_m, y_m, radius_m belong together; give all or none"),
        ({"kind": "push", "target": "force_x", "value": 1.0}, "did you mean 'force_x_n'?"),
        ({"kind": "bias", "target": "truth.xm", "value": 1.0}, "did you mean 'truth.x_m'?"),
        ({"kind": "bias", "target": "loop.t_s", "value": 1.0}, "is not a target of bias"),
        ({"kind": "bias", "target": "robot.state", "value": 1.0}, "is not a quantity"),
        ({"kind": "override", "target": "robot.state", "value": 77.0}, "is not a state of the firmware"),
    ],
    ids=lambda case: " ".join(map(str, case.values())) if isinstance(case, dict) else "",
)
def test_a_wrong_row_is_refused_with_its_place_in_one_sentence(tmp_path, row, words) -> None:
    with pytest.raises(BadInputError) as error:
        load(str(write(tmp_path, [row])))
    (sentence,) = str(error.value).splitlines()
    assert words in sentence
    assert "faulty.toml:" in sentence or "missing" in sentence


def test_each_row_has_chance_of_its_own_that_the_others_do_not_change() -> None:
    rows = [FaultRow("drop", "link", "command", 0, 100 + n // 2, 0.5) for n in range(6)]
    numbers = [chance.random() for chance in generators(rows, 1)]
    assert len(set(numbers)) == 6
    assert [chance.random() for chance in generators(rows[2:], 1)] == numbers[2:]
    assert not set(numbers) & {chance.random() for chance in generators(rows, 2)}
