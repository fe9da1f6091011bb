"""A scenario that was run as a test: whether it passed, its text, and its entries in a report."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

import pytest

from hil.addons.testing.overrides import shown
from hil.core.errors import DeviceError, HilError, LinkError
from hil.core.printable import command
from hil.judge.result import RunResult
from hil.judge.run_text import applied_text, why_not_passed
from hil.scenario import Scenario

_FACTS = ("law", "mode", "link", "seed", "wire_sha256")
_FIGURES = ("tracked_s", "t10_s", "steady_rms_m", "steady_max_m", "ticks", "realtime_factor", "deadline_misses")
_BROKEN = {LinkError: "the link failed, not an expectation", DeviceError: "the robot failed, not an expectation"}


@dataclass(frozen=True)
class CheckedRun:
    """A scenario that was run as a test.

    Attributes:
        scenario: the scenario of the run.
        result: the finished run, or None when it could not begin.
        error: the error that ended the run early or prevented it, or None.
        recording: the recording, or None.
        repeat: the command that repeats the run.
    """

    scenario: Scenario
    result: RunResult | None
    error: HilError | None
    recording: Path | None
    repeat: str

    @property
    def passed(self) -> bool:
        """Whether the run ended as expected."""
        return self.result is not None and self.result.passed

    def text(self) -> str:
        """Return the report: every problem, then the outcome of each expectation and fault, then the next commands."""
        scenario = self.scenario
        name = shown(scenario.path or scenario.name)
        rows = [("scenario", f"{name}, {scenario.loop.mode}, {scenario.link.url}, seed {scenario.loop.seed}")]
        if self.result is not None:
            rows += [("expectation", row.text) for row in self.result.run.expect]
            rows += [("fault", applied_text(row)) for row in self.result.run.faults]
        rows += self._recorded()
        rows.append(("repeat it", self.repeat))
        return "\n".join([*self._problems(), "", *(f"  {label:<12} {line}" for label, line in rows)])

    def properties(self) -> list[tuple[str, str]]:
        """Return the entries of the run in a test report, by name; figures without a value are left out."""
        metrics: Mapping[str, Any] = {"seed": self.scenario.loop.seed} if self.result is None else self.result.metrics
        kept = [("scenario", self.scenario.name), *((name, metrics.get(name)) for name in (*_FACTS, *_FIGURES))]
        if self.result is not None:
            kept += [(f"link.{name}", value) for name, value in _link_figures(metrics)]
        kept += [("failure", self.error), ("recording", self.recording)]
        return [(name, str(value)) for name, value in kept if value is not None]

    def _problems(self) -> Iterator[str]:
        """Yield a line for each problem, a cause before its consequences."""
        if self.error is not None:
            kind = next((words for cause, words in _BROKEN.items() if isinstance(self.error, cause)), None)
            yield str(self.error) if kind is None else f"{kind}: {self.error}"
        if self.result is not None:
            reasons = why_not_passed(self.result.run)
            yield from (f"{kind}: {why}" for kind, why in reasons if kind != "failure")

    def _recorded(self) -> list[tuple[str, str]]:
        if self.recording is None:
            return [("recording", "none was kept")]
        path = shown(self.recording)
        look, tell = (command("hil", verb, PurePath(path)) for verb in ("view", "review"))
        rows = [("recording", path), ("look at it", look), ("", tell)]
        recorded = None if self.result is None else self.result.run.recorded
        if recorded is not None and (why := recorded.why_incomplete) is not None:
            rows[0] = ("recording", f"{path}, incomplete: {why}")
        return rows


def add_to_report(item: pytest.Item, checked: CheckedRun, number: str = "") -> None:
    """Add a run's entries to the test's properties; ``number`` tells several runs of one test apart."""
    item.user_properties += [(f"hil{number}.{name}", value) for name, value in checked.properties()]


def forget_runs(item: pytest.Item) -> None:
    """Remove the entries of an earlier attempt, as of --reruns: the report is about the last one."""
    item.user_properties[:] = [one for one in item.user_properties if not re.match(r"hil(-\d+)?\.", one[0])]


def run_as_test(
    scenario: Scenario, truth: str | None, record: Path | None, repeat: str, config: pytest.Config
) -> CheckedRun:
    """Run a scenario and return its outcome. ``repeat`` is the command that repeats it.

    A law that takes too long and cannot be interrupted ends the pytest session. Capturing is suspended before that, so
    that the message about it is seen.
    """
    from hil.runtime.assembly import RunOptions, run_scenario

    def uncapture(_sentence: str) -> None:
        if (capturing := config.pluginmanager.getplugin("capturemanager")) is not None:
            capturing.suspend_global_capture(in_=False)

    result, error = None, None
    try:
        options = RunOptions(truth=truth, record=record, on_stuck=uncapture)
        result = run_scenario(scenario, config.hook.pytest_hil_run_options(options=options) or options)
        error = result.failure
    except HilError as before_the_run:
        error = before_the_run
    recording = record if record is not None and record.exists() else None
    return CheckedRun(scenario, result, error, recording, repeat)


def _link_figures(metrics: Mapping[str, Any]) -> Iterator[tuple[str, float | None]]:
    """Yield the main figures of the link (hil/wire/STATISTICS.md); None for one that does not exist for this link."""
    link = metrics["link_statistics"]
    for way in ("sent", "received"):
        yield f"{way}_frames", link[way]["frames"]
        yield f"{way}_bytes", link[way]["bytes"]
    yield "lost_snapshots", link["lost"]["snapshots"]
    yield "rejected", sum(link["rejected"].values())
    loads = (load["worst_100_ms_percent"] for load in (link["load"] or {}).values())
    yield "worst_load_percent", max(loads, default=None)
    for name, figure in (("round_trip", link["round_trip_ms"]), ("feedback_age", link["feedback_age_ms"])):
        for share in ("p50", "p99"):
            yield f"{name}_{share}_ms", None if figure is None else figure[share]
    yield "recoveries", len(metrics["recoveries"])
