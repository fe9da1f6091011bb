"""Does one member of a suite in a worker process, which may have a mutant."""

import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from hil.batch.job import ENDED, FAILED, PASSED, REFUSED, Job, Outcome
from hil.batch.run import attempt, kept_robot
from hil.core.scratch import scratch_folder
from hil.judge.baselines import baseline_figures
from hil.judge.figures import number
from hil.judge.measure import Series
from hil.judge.words import why_not_passed
from hil.review.result import RunResult
from hil.runtime.assembly import RunOptions
from hil.scenario import Scenario

Extremes = list[float | None]
"""Of a signal: least and greatest value in the whole run, then in its second half; None where one is not finite."""
_NOT_OF_THE_RUN = ("loop.", "link.clock")
_PACKAGES = ("hil.", "firmware_protocol.", "plant_fmu.")
_NO_TESTS = 5


def run(job: Job, scenario: Scenario) -> Outcome:
    """Run a scenario. The figures are those that can be expected, and the wire's hash; details have ``extremes``, and
    ``by_bytes``: whether nothing but other bytes on the wire than those of its baseline failed it.

    In a process of its own they have the ``modules`` of this package that it has imported.
    """

    def judge(result: RunResult) -> Outcome:
        status = FAILED if result.failure is None else ENDED
        reasons = list(why_not_passed(result.metrics))
        reason = next((words for _, words in reasons), None)
        if result.passed:
            status, reason = PASSED, None
        metrics = result.metrics
        figures: dict[str, Any] = {key: number(metrics, one.name) for key, one in baseline_figures().items()}
        figures |= {"wire_sha256": metrics["wire_sha256"], "applied": [row["applied"] for row in metrics["fault"]]}
        details: dict[str, Any] = {"extremes": extremes(result.signals, scenario.loop.duration_s)}
        baseline = metrics["baseline"] or {}
        details["by_bytes"] = {kind for kind, _ in reasons} == {"baseline"} and not baseline["figures"]
        if "process" in job.options:
            details["modules"] = sorted(name for name in sys.modules if name.startswith(_PACKAGES))
        return Outcome(job.key, status, reason, figures, details)

    return attempt(job, scenario, judge, RunOptions(make_robot=kept_robot()))


def run_tests(job: Job, _scenario: Scenario) -> Outcome:
    """Run a file of tests by pytest until one fails. The figures are the hashes of the wire of its lockstep runs."""
    with scratch_folder("verify") as folder:
        report = folder / "report.xml"
        command = [sys.executable, "-m", "pytest", "-x", "-q", "--tb=line", "-p", "no:cacheprovider"]
        command += [f"--junitxml={report}", f"--basetemp={folder}/tmp", str(job.options["tests"])]
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
        if done.returncode == 0:
            return Outcome(job.key, PASSED, None, dict(_hashes(ET.parse(report).getroot())))
        said = (done.stdout + done.stderr).strip().splitlines()
        if done.returncode == 1 and report.is_file():
            failed = (case for case in ET.parse(report).iter("testcase") if len(case) and case[0].tag != "skipped")
            return Outcome(job.key, FAILED, next((_why(case) for case in failed), "a test failed"))
        status = REFUSED if done.returncode in (2, 3, 4, _NO_TESTS) else FAILED
        return Outcome(job.key, status, f"pytest ended with {done.returncode}: {said[-1] if said else 'no word'}")


def extremes(signals: Mapping[str, Series], duration_s: float) -> dict[str, Extremes]:
    """Return least and greatest value of each signal, in the whole run and in its second half."""
    late = signals["loop.t_s"] >= late_from_s(duration_s)
    found = {}
    for name, values in signals.items():
        if not name.startswith(_NOT_OF_THE_RUN):
            windows = (values, values[late])
            found[name] = [_finite(extreme(part)) if len(part) else None for part in windows for extreme in _EXTREMES]
    return found


def late_from_s(duration_s: float) -> float:
    """Return the time from which on the second half of a run is [s]."""
    return round(0.5 * duration_s, 3)


_EXTREMES = (np.min, np.max)


def _finite(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


def _hashes(report: ET.Element) -> Iterator[tuple[str, str]]:
    for case in report.iter("testcase"):
        values = {row.attrib["name"]: row.attrib["value"] for row in case.iter("property")}
        for name, value in values.items():
            if name.endswith(".wire_sha256") and values.get(name.replace("wire_sha256", "mode")) == "lockstep":
                yield f"{case.attrib['name']} {name}", value


def _why(case: ET.Element) -> str:
    lines = (case[0].attrib.get("message") or case[0].text or "").strip().splitlines()
    return f"{case.attrib['name']}: {lines[0] if lines else case[0].tag}"
