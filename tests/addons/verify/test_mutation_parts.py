"""How a mutant changes numbers and frames, tick by tick; what is suggested for a survivor, and how it is told."""

import math
from collections.abc import Iterable, Mapping
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from firmware_protocol.extension import library
from firmware_protocol.framing import Frame
from hil.addons.batch.job import PASSED, Outcome
from hil.addons.verify import results
from hil.addons.verify.catalogue import Entry
from hil.addons.verify.mutation.change import Change
from hil.addons.verify.mutation.mutant import IDS, ChangedLink, Mutant, moved
from hil.addons.verify.mutation.wrappers import DRIVE, SENSE, changed_node
from hil.addons.verify.suggest import Suggestion, extremes, suggestion
from hil.addons.verify.verify import NOTICED, SURVIVED, UNREACHED, Verdict, Verification
from hil.core.ports import Link, Received


@pytest.mark.parametrize(
    ("name", "size", "expected"),
    [
        ("scale", 0.5, [0.5, 1.0, -2.0, 4.0, 8.0, 16.0]),
        ("offset", 1.0, [2.0, 3.0, -3.0, 9.0, 17.0, 33.0]),
        ("limit", 3.0, [1.0, 2.0, -3.0, 3.0, 3.0, 3.0]),
        ("deadband", 2.0, [0.0, 2.0, -4.0, 8.0, 16.0, 32.0]),
        ("quantum", 3.0, [0.0, 3.0, -3.0, 9.0, 15.0, 33.0]),
        ("wrap", 10.0, [1.0, 2.0, -4.0, -2.0, -4.0, 2.0]),
        ("delay", 2, [1.0, 1.0, 1.0, 2.0, -4.0, 8.0]),
        ("hold", 3, [1.0, 1.0, 1.0, 8.0, 8.0, 8.0]),
        ("drift", 0.5, [1.5, 3.0, -2.5, 10.0, 18.5, 35.0]),
        ("lag", 1.0, [1.0, 1.5, -1.25, 3.375, 9.6875, 20.84375]),
        ("freeze", 2, [1.0, 2.0, -4.0, -4.0, -4.0, -4.0]),
        ("drop_out", 3, [1.0, 2.0, 2.0, 8.0, 16.0, 16.0]),
        ("spike", 3, [1.0, 2.0, -40.0, 8.0, 16.0, 320.0]),
    ],
)
def test_a_change_of_one_element_is_in_its_ticks_and_leaves_the_others(
    name: str, size: float, expected: list[float]
) -> None:
    change, given = Change(("a", "b", "c"), {name: size, "element": "b"}), (1.0, 2.0, -4.0, 8.0, 16.0, 32.0)
    assert [change((7.0, value, 9.0)) for value in given] == [(7.0, value, 9.0) for value in expected]
    whole = Change(("a", "b"), {name: size})
    assert [whole((value, value)) for value in given] == [(value, value) for value in expected]


def test_an_order_and_what_is_no_number_pass_too() -> None:
    assert Change(("a", "b", "c"), {"order": [2, 0, 1]})((1.0, 2.0, 3.0)) == (3.0, 1.0, 2.0)
    lag = Change(("a",), {"lag": 1.0})
    found = [lag((value,))[0] for value in (4.0, math.nan, 6.0)]
    assert (found[0], math.isnan(found[1])) == (4.0, True)
    for name in ("quantum", "wrap"):
        assert math.isnan(Change(("a",), {name: 2.0})((math.nan,))[0])


@pytest.mark.parametrize(
    ("change", "value"), [("*1.5", 6.0), ("+0.5", 4.5), ("-0.5", 3.5), (7.0, 7.0), ("name", "name")]
)
def test_a_value_is_scaled_moved_or_replaced(change: object, value: object) -> None:
    assert moved(4, change) == value


class Line:
    """A link with frames to give, one at a time, that keeps those sent."""

    def __init__(self, frames: list[Frame]) -> None:
        self.sent: list[Frame] = []
        self._frames = iter(frames)

    def send(self, frame: Frame) -> None:
        self.sent.append(frame)

    def receive(self, timeout_ns: int) -> Received | None:
        frame = next(self._frames, None)
        return None if frame is None else Received([frame], 5)


CHANGED, OTHER = IDS["WheelCommand"], IDS["HostHeartbeat"]
FRAMES = [Frame(CHANGED, bytes([number, 0])) for number in range(1, 8)]


@pytest.mark.parametrize(
    ("name", "size", "expected"),
    [
        ("lose", 3, [1, 2, 4, 5, 7]),
        ("repeat", 3, [1, 2, 3, 3, 4, 5, 6, 6, 7]),
        ("late", 2, [1, 2, 3, 4, 5]),
        ("swap", 3, [1, 2, 4, 3, 5, 7, 6]),
        ("flip", 1, [3, 0, 1, 6, 7, 4, 5]),
        ("flip", 16, [1, 2, 3, 4, 5, 6, 7]),
        ("stale", 3, [1, 2, 2, 4, 5, 5, 7]),
    ],
)
def test_frames_of_one_message_and_one_direction_are_changed(name: str, size: int, expected: list[int]) -> None:
    for of in ("sent", "received"):
        line = Line(FRAMES)
        link = ChangedLink(cast("Link", line), {"port": "link", "of": of, "id": "WheelCommand", name: size})
        for frame in FRAMES:
            link.send(frame)
            link.send(Frame(OTHER, b"x"))
        received: list[Frame] = []
        while (some := link.receive(0)) is not None:
            assert some.stamp_ns == 5
            received += some.frames
        sent = [frame.payload[0] for frame in line.sent if frame.id == CHANGED]
        assert line.sent.count(Frame(OTHER, b"x")) == len(FRAMES)
        untouched = [frame.payload[0] for frame in FRAMES]
        assert (sent, [frame.payload[0] for frame in received]) == (
            (expected, untouched) if of == "sent" else (untouched, expected)
        )


def test_a_bit_of_the_second_byte_is_flipped_in_it() -> None:
    line = Line([])
    link = ChangedLink(cast("Link", line), {"port": "link", "of": "sent", "id": "WheelCommand", "flip": 11})
    link.send(Frame(CHANGED, bytes([1, 2, 3])))
    assert line.sent == [Frame(CHANGED, bytes([1, 2 ^ 8, 3]))]


SENSED: dict[str, Any] = {
    "count": [65534, 0, 8, 100], "current_a": [1.5, -2.5, 3.0, 0.0], "gyro_rad_s": [0.5, -0.25, 0.125],
    "acceleration_m_s2": [-1.5, 0.75, 9.5], "battery_v": 24.5, "battery_a": -3.5,
    "temperature_degc": [20.5, 21.5, 22.5, 23.5],
}  # fmt: skip
DRIVEN: dict[str, Any] = {"torque_n_m": [0.5, -1.5, 2.5, 3.0], "duty": [0.5, 0.25, -0.125, 1.0], "enabled": 6}
COUNTED = [([65534, 0, 8, 100], [32767, 0, 4, 50]), ([2, 65530, 8, 100], [32769, 65533, 4, 50])]  # over the wrap


def fields(block: Any, names: Iterable[str]) -> dict[str, Any]:
    return {name: value if isinstance(value := getattr(block, name), int | float) else list(value) for name in names}


@pytest.mark.parametrize("of", [*DRIVE, *SENSE])
def test_between_firmware_and_plant_one_field_is_halved_and_no_other(of: str) -> None:
    ffi, _ = library()
    driven: list[Any] = []

    def plant(_context: object, drive: Any, sense: Any) -> int:
        for name, value in {**SENSED, "count": COUNTED[len(driven)][0]}.items():
            setattr(sense, name, value)
        driven.append(drive if drive == ffi.NULL else fields(drive, DRIVEN))
        return 6 + len(driven)

    callback = ffi.callback("int(void *, const wheel_drive *, wheel_sense *)", plant)
    make: Any = lambda _values, address, _context: SimpleNamespace(address=address)  # noqa: E731
    node: Any = changed_node(make, {"of": of, "scale": 0.5})({}, int(ffi.cast("uintptr_t", callback)), 0)
    exchange, drive = ffi.cast("wheel_plant_exchange", node.address), ffi.new("wheel_drive *", DRIVEN)
    halves = {name: np.multiply(value, 0.5).tolist() for name, value in (SENSED | DRIVEN).items()}
    for number, (count, half) in enumerate(COUNTED):
        answer = exchange(ffi.NULL, drive if number else ffi.NULL, sense := ffi.new("wheel_sense *"))
        halved = {**halves, "count": half}
        expected = {name: halved[name] if name == of else value for name, value in {**SENSED, "count": count}.items()}
        assert (answer, fields(sense, SENSED)) == (7 + number, expected)
    assert fields(drive, DRIVEN) == DRIVEN, "the firmware's own block"
    assert driven == [ffi.NULL, {name: halves[name] if name == of else value for name, value in DRIVEN.items()}]


# What is suggested


def run(figures: Mapping[str, Any], **signals: list[float | None]) -> Outcome:
    return Outcome(
        "", PASSED, None, figures, {"extremes": {name.replace("__", "."): of for name, of in signals.items()}}
    )


def test_extremes_are_of_the_whole_run_and_of_its_second_half() -> None:
    t_s = np.array([0.0, 0.5, 1.0, 1.5, 2.0])
    signals = {
        "loop.t_s": t_s,
        "loop.tick_us": t_s,
        "link.clock_offset_s": t_s,
        "a": np.array([5.0, -7.0, 1.0, 2.0, 3.0]),
    }
    signals["b"] = np.array([1.0, math.nan, 1.0, 4.0, 3.0])
    assert extremes(signals, 3.0) == {"a": [-7.0, 5.0, 2.0, 3.0], "b": [None, None, 3.0, 4.0]}
    assert extremes(signals, 5.0) == {"a": [-7.0, 5.0, None, None], "b": [None, None, None, None]}


def test_a_figure_that_moved_is_claimed_about_halfway() -> None:
    healthy = [run({"a": 1.0, "b": 5.0, "sha": "x"}), run({"a": 1.1, "b": 5.0, "sha": "x"})]
    found = suggestion("mine", 3.0, healthy, run({"a": 2.0, "b": 4.0, "sha": "y"}))
    assert found == Suggestion("mine", "figure", "a", 0.0, "below", 1.6, 1.1, 2.0, pytest.approx(0.25))
    assert found.toml == '[[expect]]\nfigure = "a"\nbelow = 1.6\n'
    lacking = [run({"a": 1.0, "c": None}), run({"a": None, "c": None})]
    assert suggestion("mine", 3.0, lacking, run({"a": 2.0, "c": 9.0})) is None, "not all runs have the figure"
    assert suggestion("mine", 3.0, healthy, run({"a": None, "b": 5.0, "sha": None})) is None
    less = suggestion("mine", 3.0, healthy, run({"a": 1.05, "b": 4.0, "sha": "y"}))
    assert less == Suggestion("mine", "figure", "b", 0.0, "above", 4.5, 5.0, 4.0, pytest.approx(0.1))


@pytest.mark.parametrize(
    ("healthy", "mutated", "is_claimed"),
    [
        ([1.0, 1.0], 1.0199, False),
        ([1.0, 1.0], 1.0201, True),
        ([1.0, 1.1], 1.399, False),
        ([1.0, 1.1], 1.401, True),
        ([1.0, 1.1], 0.701, False),
        ([1.0, 1.1], 0.699, True),
        ([0.0, 0.0], 0.9e-9, False),
        ([0.0, 0.0], 1.1e-9, True),
        ([-1.0, -1.0], -1.0199, False),
        ([-1.0, -1.0], -1.0201, True),
    ],
)
def test_what_moved_less_than_a_fiftieth_or_three_spreads_is_not_claimed(
    healthy: list[float], mutated: float, is_claimed: bool
) -> None:
    found = suggestion("mine", 3.0, [run({"a": value}) for value in healthy], run({"a": mutated}))
    assert (found is not None) is is_claimed
    if found is not None:
        low, high = sorted((found.healthy, found.mutated))
        assert 0.25 <= (found.bound - low) / (high - low) <= 0.75
        assert found.side == ("below" if mutated > max(healthy) else "above")


def test_of_signals_with_a_clear_margin_the_one_that_reads_best_is_claimed() -> None:
    healthy = [run({}, robot__a=[-1.0, 2.0, 0.0, 1.0], error__x_m=[0.0, 4.0, 0.0, 1.0], other=[0.0, 1.0, 0.0, 1.0])]
    changed = run({}, robot__a=[-9.0, 2.0, 0.0, 1.0], error__x_m=[0.0, 4.0, 0.0, 2.0], other=[0.0, 9.0, 0.0, 9.0])
    found = suggestion("mine", 3.0, healthy, changed)
    assert found == Suggestion("mine", "signal", "error.x_m", 1.5, "below", 1.5, 1.0, 2.0, pytest.approx(0.125))
    assert found.toml == '[[expect]]\nsignal = "error.x_m"\nfrom_s = 1.5\nbelow = 1.5\n'
    barely = run({}, robot__a=[-9.0, 2.0, 0.0, 1.0], error__x_m=[0.0, 4.1, 0.0, 1.0], other=[0.0, 1.0, 0.0, 1.0])
    least = suggestion("mine", 3.0, healthy, barely)
    assert least == Suggestion("mine", "signal", "robot.a", 0.0, "above", -5.0, -1.0, -9.0, pytest.approx(4.0 / 9.0))
    # A margin of exactly a twentieth is clear.
    slight = suggestion(
        "mine", 3.0, [run({"f": 20.0}, a=[0.0, 1.0, 0.0, 1.0])], run({"f": 18.0}, a=[0.0, 9.0, 0.0, 9.0])
    )
    assert slight is not None
    assert (slight.name, slight.bound, slight.margin) == ("f", 19.0, 0.05)
    gone = run({}, robot__a=[None, None, None, None], error__x_m=[0.0, 4.0, 0.0, 1.0], other=[0.0, 1.0, 0.0, 1.0])
    assert suggestion("mine", 3.0, healthy, gone) is None


def test_what_a_verification_found_is_told_with_counts_rooms_and_remedies() -> None:
    def entry(room: str, name: str) -> Entry:
        return Entry(room, f"{name} is wrong", "10 %", Mutant(f"{room}.{name}"))

    claim = Suggestion("mine", "figure", "a", 0.0, "below", 1.6, 1.1, 2.0, 0.256)
    verdicts = [
        Verdict(entry("plant", "mass"), NOTICED, "mine", "too far", runs=1),
        Verdict(entry("plant", "gyro"), SURVIVED, moved=["mine", "other"], suggestion=claim, runs=2),
        Verdict(entry("wire", "bit"), SURVIVED, moved=["mine", "other"], runs=2),
        Verdict(entry("wire", "late"), UNREACHED, runs=2),
    ]
    found = Verification(verdicts, 5, [("mine", "seed 7", "too far")], {"mine": 1.0}, 61.4)
    assert list(results.lines(found)) == [
        "survived: plant.gyro: gyro is wrong (10 %)",
        "    add to mine (healthy 1.1, with the mutant 2, margin 26 %):",
        "    [[expect]]",
        '    figure = "a"',
        "    below = 1.6",
        "survived: wire.bit: bit is wrong (10 %)",
        "    it moved mine, other by less than healthy runs differ: a baseline's bytes would notice it",
        "unreached: wire.late: late is wrong (10 %)",
        "    no member goes where it is: add a scenario that does",
        "false alarm: mine (seed 7): too far",
        "",
        "  plant      2 mutants: 1 noticed, 1 survived",
        "  wire       2 mutants: 1 survived, 1 unreached",
        "  all        4 mutants: 1 noticed, 2 survived, 1 unreached (25.0 %)",
        "  1 false alarms in 5 healthy runs; 61 s",
    ]
    table = results.as_json(found)
    assert table["rooms"] == {
        "plant": {"noticed": 1, "survived": 1, "unreached": 0},
        "wire": {"noticed": 0, "survived": 1, "unreached": 1},
    }
    alarms = [{"member": "mine", "varied": "seed 7", "reason": "too far"}]
    assert table["healthy"] == {"runs": 5, "false_alarms": alarms}
    assert [(one["by"], one["reason"], one["runs"]) for one in table["mutants"]] == [
        *[("mine", "too far", 1)], *[(None, None, 2)] * 3,
    ]  # fmt: skip
    assert not found._replace(least=0.25).passed, "an alarm was false"
    assert found._replace(least=0.25, alarms=[]).passed
    assert Verification([], 1, [], {}, 1.0).passed
    assert list(results.lines(Verification([], 1, [], {}, 1.0)))[1] == "  all        0 mutants: "
