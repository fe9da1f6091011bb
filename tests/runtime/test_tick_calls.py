"""The cost of a tick, in calls of Python functions: a figure that no other load changes."""

import sys
from collections import Counter
from types import FrameType

from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import load

MOST = 40  # 29 when this was written, law and reference among them
TICKS = 500


def calls_of(seconds: float) -> Counter[str]:
    """Return how often each Python function is called in a run of the paper's circle."""
    calls: Counter[str] = Counter()

    def count(frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            calls[frame.f_code.co_qualname] += 1

    scenario = load("paper_circle", set={"loop.duration_s": seconds, "expect": []})
    before = sys.getprofile()
    sys.setprofile(count)
    try:
        run_scenario(scenario, RunOptions(truth=None, record=None, keep_signals=False))
    finally:
        sys.setprofile(before)
    return calls


def test_a_tick_makes_few_calls_in_python() -> None:
    calls_of(0.01)  # what is done once a process
    short, long = calls_of(0.5), calls_of(1.0)
    each = {name: (count - short[name]) / TICKS for name, count in long.items()}
    most = [f"{count:.1f} {name}" for name, count in sorted(each.items(), key=lambda one: -one[1]) if count > 0.5]
    assert 10.0 < sum(each.values()) < MOST, f"in a tick: {', '.join(most)}"
