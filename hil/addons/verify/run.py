"""Does one member of a suite in a worker process, which may have a mutant."""

import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from typing import Any

from hil.addons.batch.job import ENDED, FAILED, PASSED, REFUSED, Job, Outcome
from hil.addons.batch.run import attempt, kept_robot
from hil.addons.verify import plugin
from hil.addons.verify.mutation.mutant import from_text
from hil.addons.verify.suggest import extremes
from hil.core.scratch import scratch_folder
from hil.judge.baselines import baseline_figures
from hil.judge.result import RunResult
from hil.judge.run_text import why_not_passed
from hil.runtime.assembly import RunOptions
from hil.scenario import Scenario

_NO_TESTS = 5


def run(job: Job, scenario: Scenario) -> Outcome:
    """Run a scenario. The figures are those that can be expected, and the wire's hash; details have ``extremes``."""

    def judge(result: RunResult) -> Outcome:
        status = FAILED if result.failure is None else ENDED
        reason = next((text for _, text in why_not_passed(result.run)), None)
        if result.passed:
            status, reason = PASSED, None
        judged = result.run
        figures: dict[str, Any] = {key: judged.number(one.name) for key, one in baseline_figures().items()}
        figures |= {"wire_sha256": judged.wire_sha256, "applied": [row.applied for row in judged.faults]}
        details = {"extremes": extremes(result.signals, scenario.loop.duration_s)}
        return Outcome(job.key, status, reason, figures, details)

    options = RunOptions(make_robot=kept_robot())
    if (mutant := job.options.get("mutant")) is not None:
        options = from_text(mutant).put_into(options)
    return attempt(job, scenario, judge, options)


def run_tests(job: Job, _scenario: Scenario) -> Outcome:
    """Run a file of tests by pytest until one fails. The figures are the hashes of the wire of its lockstep runs."""
    with scratch_folder("verify") as folder:
        report = folder / "report.xml"
        command = [sys.executable, "-m", "pytest", "-x", "-q", "--tb=line", "-p", "no:cacheprovider"]
        command += [f"--junitxml={report}", f"--basetemp={folder}/tmp", str(job.options["tests"])]
        if (mutant := job.options.get("mutant")) is not None:
            command += ["-p", plugin.__name__, plugin.OPTION, mutant]
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
        if done.returncode == 0:
            return Outcome(job.key, PASSED, None, dict(_hashes(ET.parse(report).getroot())))
        said = (done.stdout + done.stderr).strip().splitlines()
        failed = map(_why, ET.parse(report).iter("testcase")) if done.returncode == 1 and report.is_file() else ()
        if (why := next(filter(None, failed), None)) is not None:
            return Outcome(job.key, FAILED, why)
        status = REFUSED if done.returncode in (2, 3, 4, _NO_TESTS) else FAILED
        return Outcome(job.key, status, f"pytest ended with {done.returncode}: {said[-1] if said else 'no word'}")


def _hashes(report: ET.Element) -> Iterator[tuple[str, str]]:
    for case in report.iter("testcase"):
        values = {row.attrib["name"]: row.attrib["value"] for row in case.iter("property")}
        for name, value in values.items():
            if name.endswith(".wire_sha256") and values.get(name.replace("wire_sha256", "mode")) == "lockstep":
                yield f"{case.attrib['name']} {name}", value


def _why(case: ET.Element) -> str | None:
    for one in (one for one in case if one.tag in ("failure", "error")):
        lines = (one.attrib.get("message") or one.text or "").strip().splitlines()
        return f"{case.attrib['name']}: {lines[0] if lines else one.tag}"
    return None
