"""The members of a suite: scenarios, and pytest files, each of which may notice a mutant."""

import functools
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from firmware_protocol.built import ROOT
from hil.addons.batch.job import Job
from hil.addons.batch.keys import make_job
from hil.addons.verify.mutation.mutant import Mutant, moved
from hil.core import TEST_SUFFIX
from hil.core.errors import BadInputError
from hil.core.options import plain
from hil.plant import archive
from hil.plant.description import start_defaults
from hil.runtime.robots import link_of, plant_start
from hil.scenario import Scenario, load
from hil.scenario.baseline import is_baseline, without_baselines

RUN, TESTS = "hil.addons.verify.run:run", "hil.addons.verify.run:run_tests"
"""The kinds of job."""


class Member(NamedTuple):
    """A member of a suite: a scenario, or a file of tests; then the scenario is only what its job is made with."""

    name: str
    scenario: Scenario
    tests: Path | None = None

    def job(self, mutant: Mutant | None = None, *, limit_s: float = 120.0) -> Job:
        """Return the job of the member, with a mutant if there is one."""
        baseline = None if self.scenario.baseline is None else plain(self.scenario.baseline)
        options: dict[str, Any] = {"code": _code(), "baseline": _sha256(json.dumps(baseline, sort_keys=True).encode())}
        if mutant is not None:
            options["mutant"] = mutant.to_text()
        if self.tests is not None:
            options |= {"tests": str(self.tests), "sha256": _sha256(self.tests.read_bytes())}
        kind = RUN if self.tests is None else TESTS
        return make_job(self.scenario, kind, options, limit_s=limit_s)

    def varied(self, seed: int, variation: Mapping[str, Any]) -> "Member":
        """Return the scenario with another seed and with start values that a healthy robot may have.

        Start values that its FMU does not have are left out. A varied plant is judged without the baseline, which is
        that of one plant and there to notice another.
        """
        scenario = self.scenario
        fmu = archive.locate(scenario.plant.fmu, scenario.directory)
        defaults = start_defaults(fmu)
        now = {**defaults, **plant_start(scenario, archive.read_header(fmu).parameters)}
        changed = {name: moved(now[name], change) for name, change in variation.items() if name in defaults}
        plant = replace(scenario.plant, start={**scenario.plant.start, **changed})
        loop, baseline = replace(scenario.loop, seed=seed), None if changed else scenario.baseline
        return self._replace(scenario=replace(scenario, plant=plant, loop=loop, baseline=baseline))


def read_suite(names: Sequence[str], *, baselines: bool = True) -> list[Member]:
    """Return the members that are named: scenarios, test files, and folders of these; at least one is named.

    A baseline that is named with its scenario, as by a shell's ``suite/*.toml``, is left out.
    Without ``baselines`` they are judged by their expectations and [allow] alone.

    Raises BadInputError without a name, for a file that is neither, and for a scenario that does not run in this
    process in lockstep.
    """
    if not names:
        raise BadInputError("no suite is named; give scenarios, pytest files, or folders of them")
    found: dict[str, Member] = {}
    for name in without_baselines(names):
        path = Path(name)
        for one in _in_folder(path) if path.is_dir() else [name]:
            member = _member(str(one))
            kept = member.scenario.baseline if baselines else None
            found[member.name] = member._replace(scenario=replace(member.scenario, baseline=kept))
    return list(found.values())


@functools.cache
def _code() -> str:
    """Return a hash of the Python files of this package: with others, earlier outcomes say nothing."""
    digest = hashlib.sha256()
    for path in sorted((ROOT / "hil").rglob("*.py")):
        digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _in_folder(folder: Path) -> list[Path]:
    scenarios = [path for path in folder.glob("*.toml") if not is_baseline(path)]
    found = sorted([*scenarios, *folder.glob("test_*.py"), *folder.glob("*_test.py")])
    if not found:
        raise BadInputError(f"suite {folder}: it has neither scenarios (*.toml) nor tests (test_*.py)")
    return found


def _member(name: str) -> Member:
    if name.endswith(".py"):
        path = Path(name).absolute()
        if not path.is_file():
            raise BadInputError(f"suite {name}: there is no such file")
        return Member(name, load("paper_circle"), path)
    scenario = load(name, mode="lockstep")
    if not link_of(scenario).is_within_process:
        raise BadInputError(
            f"suite {name}: its robot is behind {scenario.link.url}; mutants are put into a virtual robot, so give a "
            "scenario with link.url = memory:"
        )
    return Member(name.removesuffix(TEST_SUFFIX), scenario)
