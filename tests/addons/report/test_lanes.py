"""The lanes of a run as they are written: each change of a state, its time, and the colours of the states."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.addons.report.claim_watch import ClaimWatch, Standing, claims
from hil.addons.report.lanes import States
from hil.core.signals import TRUE_POSE, WHEEL_SPEEDS
from tests.support.golden import assert_golden

GOLDEN = Path(__file__).parent / "golden"
NAN = float("nan")
COLUMN = {
    name: place
    for place, name in enumerate(
        ("loop.t_s", "loop.tick", "robot.state", "link.rejected", "link.lost", "link.feedback_age_ms",
         "estimator.health", "error.x_m", "guard.limit")
    )
}  # fmt: skip
ROWS = np.array(
    [
        (0.000, 0, NAN, 0, 0, 5.0, 0, 0.5, 0), (0.125, 1, 2, 0, 0, 5.0, 0, 0.5, 2), (0.250, 2, 3, 1, 0, 5.0, 1, 1.5, 2),
        (0.375, 3, 3, 1, 0, 60.0, 2, 0.5, 1), (0.500, 4, 4, 1, 2, 50.0, 1, 1.5, 0),
        (0.625, 5, NAN, 1, 2, NAN, NAN, 0.5, 0),
        (0.750, 6, NAN, 1, 2, NAN, NAN, 0.5, 3), (0.875, 7, 99, 1, 2, 5.0, 0, 0.5, NAN),
    ]
)  # fmt: skip
VALUES: Mapping[str, Any] = {
    "firmware.watchdog_s": 0.05,
    "expect.1.signal": "error.x_m", "expect.1.below": 1.0, "expect.1.from_s": 0.25, "expect.1.to_s": 0.5,
    "expect.2.signal": "error.x_m", "expect.2.above": 0.0, "expect.2.from_s": 0.125,
    "expect.3.figure": "steady_rms_m", "expect.3.below": 1.0,
    "expect.4.stops": "FAULT", "expect.4.from_s": 0.25, "expect.4.to_s": 0.75,
    "expect.5.stops": "ESTOP", "expect.5.from_s": 0.25, "expect.5.to_s": 9.0,
    "expect.6.signal": "error.y_m", "expect.6.below": 1.0,
    "fault.1.kind": "drop", "fault.1.target": "command", "fault.1.start_s": 0.25, "fault.1.end_s": 0.5,
    "fault.2.kind": "estop", "fault.2.target": "command", "fault.2.start_s": 0.8,
    "fault.3.kind": "drop", "fault.3.target": "feedback", "fault.3.start_s": 0.9,
    "fault.4.kind": "drop", "fault.4.target": "feedback", "fault.4.start_s": 5.0,
}  # fmt: skip
OUTCOMES = [
    {"passed": passed, "violation_s": violation_s}
    for passed, violation_s in ((False, 0.25), (True, None), (None, None), (True, None), (False, 0.625), (True, None))
]
JUDGED = {"expect": OUTCOMES, "fault": [{"applied": 3}, {"applied": 1}, {"applied": 2}, {"applied": 0}]}


class Told:
    """A recording that notes what is written to it."""

    def __init__(self) -> None:
        self.changes: list[str] = []
        self.colours: list[str] = []

    def send_columns(self, path: str, indexes: Any, columns: Any) -> None:
        (t_ns,) = indexes[0].as_arrow_array().cast("int64").to_pylist()
        ((state,),) = [one.as_arrow_array().to_pylist() for one in columns]
        self.changes.append(f"{path} {t_ns / 1e9:g} {state[0]}")

    def log(self, path: str, states: Any, *, static: bool) -> None:
        assert static
        batches = [one.as_arrow_array().to_pylist() for one in states.as_component_batches()]
        values, *others = [one[0] if one and isinstance(one[0], list) else one for one in batches]
        named = zip(values, *others, strict=True)
        self.colours.append(f"{path} {', '.join(f'{value} {colour:08X} {seen}' for value, colour, seen in named)}")


def told(summary: Mapping[str, Any] | None, *, live: bool, failed_s: float | None = None, cut: int = 3) -> Told:
    recording, claimed = Told(), claims(VALUES)
    states = States(recording, COLUMN, VALUES, claimed, live=live)  # type: ignore[arg-type]
    watches = [ClaimWatch(claim, COLUMN, VALUES) for claim in claimed]
    for piece in np.split(ROWS, [cut]):
        states.rows(piece, piece[:, :2], [(watch.claim, watch(piece)) for watch in watches])
    states.finish(summary, 0.875, failed_s)
    assert states.count == len(recording.colours)
    return recording


@pytest.mark.parametrize("live", [False, True])
def test_the_lanes_of_a_run_change_so(live: bool) -> None:
    whole = told(JUDGED | {"passed": False, "failure": None}, live=live, failed_s=0.25)
    lines = ["# colours", *whole.colours, "", "# failed", *whole.changes]
    for name, summary in {
        "passed": JUDGED | {"passed": True}, "failed without a time": {"passed": False, "failure": None},
        "ended by a failure": {"passed": False, "failure": "gone"}, "not judged": {"passed": None},
        "without a verdict": {}, "killed": None,
    }.items():  # fmt: skip
        more = [line for line in told(summary, live=live).changes if "verdict" in line or name == "passed"]
        lines += ["", f"# {name}", *more]
    assert_golden(GOLDEN / f"lanes_{'live' if live else 'ended'}.txt", "\n".join(lines) + "\n")


@pytest.mark.parametrize("cut", [1, 2, 4, 7])
def test_they_change_alike_wherever_the_rows_are_cut(cut: int) -> None:
    expected = told(JUDGED | {"passed": True}, live=False)
    assert sorted(told(JUDGED | {"passed": True}, live=False, cut=cut).changes) == sorted(expected.changes)


@pytest.mark.parametrize(("below", "last"), [(4.99, Standing.VIOLATED), (5.01, Standing.HOLDING)])
def test_rest_is_judged_by_the_way_of_the_rims_from_one_piece_to_the_next(below: float, last: Standing) -> None:
    """A turn on the spot by 1 rad/s moves the rims by 0.5 m/s, which are 5 rad/s of a wheel: the first one is twice."""
    column = {name: place for place, name in enumerate(("loop.t_s", *WHEEL_SPEEDS, *TRUE_POSE))}
    rows = np.zeros((4, len(column)))
    rows[:, 0], rows[:, column["truth.heading_rad"]] = (0.0, 0.1, 0.2, 0.3), (0.0, 0.2, 0.3, 0.4)
    sizes = {"robot.half_length_m": 0.3, "robot.half_width_m": 0.2, "robot.wheel_radius_m": 0.1}
    values = {"expect.1.at_rest": True, "expect.1.below": below, **sizes}
    watch = ClaimWatch(claims(values)[0], column, values)
    standing = np.concatenate([watch(piece).standing for piece in np.split(rows, [2])])
    assert standing.tolist() == [Standing.HOLDING, Standing.VIOLATED, last, last]
