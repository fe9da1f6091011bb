"""The batch engine: a search goes by what came back and goes on from a store; a limit ends one job and no other."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
import pytest

import hil
from firmware_protocol.built import WHEEL_HOST
from hil.batch import resumable
from hil.batch.figures import KEY, MACHINE, outcome_of, row_of
from hil.batch.job import LOST, PASSED, REFUSED, Job, Outcome
from hil.batch.keys import key_of, make_job
from hil.batch.plan import run_jobs, run_plan
from hil.batch.pool import LocalPool
from hil.batch.store import Store, read_rows
from hil.core.errors import BadInputError, LinkError
from hil.core.subprocesses import MEMORY_IS_KNOWN, LifeLine
from hil.scenario import Scenario, load
from tests.processes import is_running, wait_for

SHORT = {"loop.duration_s": 0.2, "loop.rate_hz": 200, "expect": []}
LAWS = """
import time

from hil.core.types import WheelCommand, Wheels

REST = Wheels(0.0, 0.0, 0.0, 0.0)


class Rests:
    def __init__(self, model, mode):
        self.mode = mode

    def reset(self, state, reference):
        pass

    def update(self, reference, state, applied, dt_s):
        return WheelCommand(self.mode, REST, REST)


class Grows(Rests):
    def update(self, reference, state, applied, dt_s):
        heap = [bytearray(b"x" * 1_000_000) for _ in range(400)]
        time.sleep(60.0)
        return super().update(reference, state, applied, dt_s)


class Hangs(Rests):
    def update(self, reference, state, applied, dt_s):
        while True:
            pass
"""
SCHEMA = pa.schema(
    [(name, pa.string()) for name in (KEY, "outcome", "reason", f"{MACHINE}worker")]
    + [(name, pa.float64()) for name in ("effort_n_m_s", f"{MACHINE}wall_s")]
)


def of_mass(mass_kg: float) -> Scenario:
    return load("circle_speed", set=SHORT | {"plant.start.mass_kg": mass_kg})


class Bisection:
    """A plan that looks for the least mass of the robot whose run takes less than an effort, to a tenth of a kilogram:
    in its first 0.2 s a heavier robot is slower and needs less."""

    def __init__(self, effort_n_m_s: float) -> None:
        self._effort_n_m_s = effort_n_m_s
        self.low_kg, self.high_kg = 16.0, 24.0
        self._is_waiting = False

    def next_jobs(self, outcomes: Sequence[Outcome], room: int) -> Sequence[Job]:
        assert room > 0
        for outcome in outcomes:
            self._is_waiting = False
            if outcome.figures["effort_n_m_s"] < self._effort_n_m_s:
                self.high_kg = self._middle_kg
            else:
                self.low_kg = self._middle_kg
        if self._is_waiting or self.high_kg - self.low_kg < 0.1:
            return []
        self._is_waiting = True
        return [make_job(of_mass(self._middle_kg))]

    @property
    def _middle_kg(self) -> float:
        return (self.low_kg + self.high_kg) / 2.0


def test_a_search_asks_for_its_next_job_by_what_came_back_and_goes_on_from_a_store(tmp_path: Path) -> None:
    wanted = hil.run("circle_speed", set=SHORT | {"plant.start.mass_kg": 19.3}).metrics["effort_n_m_s"]
    stopped = Bisection(wanted)
    with Store(tmp_path, SCHEMA) as store:
        done: list[Outcome] = []
        some = run_plan(stopped, LocalPool(1), is_stopping=lambda: len(done) >= 3)
        for new in some:
            store.append([row_of(outcome) for outcome in new])
            done += new
    assert len(done) == 3
    known = {row[KEY]: outcome_of(row) for row in read_rows(tmp_path).to_pylist()}
    search = Bisection(wanted)
    outcomes = [one for some in run_plan(search, LocalPool(1), known=known) for one in some]
    assert search.low_kg < 19.3 <= search.high_kg
    assert search.high_kg - search.low_kg < 0.1
    assert [outcome.key in known for outcome in outcomes] == [True] * 3 + [False] * 4
    assert outcomes[:3] == [known[outcome.key] for outcome in outcomes[:3]], "what was known was not run again"
    assert {outcome.status for outcome in outcomes} == {PASSED}


def test_outcomes_are_in_the_order_of_the_jobs_and_equal_jobs_are_done_once() -> None:
    masses_kg = (24.0, 16.0, 20.0, 16.0, 20.0)
    told: list[tuple[int, int]] = []
    jobs = [make_job(of_mass(mass_kg)) for mass_kg in masses_kg]
    outcomes = run_jobs(jobs, 2, lambda done, total, _: told.append((done, total)))
    assert [outcome.key for outcome in outcomes] == [job.key for job in jobs]
    efforts = [outcome.figures["effort_n_m_s"] for outcome in outcomes]
    assert efforts[1] == efforts[3] > efforts[2] == efforts[4] > efforts[0]
    assert told == [(1, 3), (2, 3), (3, 3)]
    assert run_jobs([]) == []


@pytest.mark.skipif(not MEMORY_IS_KNOWN, reason="this system does not tell how much memory a process takes")
def test_a_job_beyond_a_limit_is_lost_with_its_process_and_the_next_is_done(tmp_path: Path) -> None:
    (tmp_path / "laws.py").write_text(LAWS, encoding="utf-8")
    grows, hangs, rests = (
        make_job(load("circle_speed", set=SHORT | {"controller.law": f"{tmp_path}/laws.py:{law}"}), **limits)
        for law, limits in (("Grows", {"memory_mb": 300.0}), ("Hangs", {"limit_s": 2.0}), ("Rests", {}))
    )
    outcomes = run_jobs([grows, hangs, rests], 1)
    assert [outcome.status for outcome in outcomes] == [LOST, LOST, PASSED]
    assert "MB of memory, more than the limit of 300 MB" in str(outcomes[0].reason)
    assert outcomes[1].reason == "hung: it was ended after 2.0 s"
    assert not any(outcome.figures for outcome in outcomes[:2])


def test_a_library_of_a_job_is_what_its_process_runs_and_part_of_its_key(tmp_path: Path) -> None:
    scenario = of_mass(20.0)
    usual = make_job(scenario)
    WHEEL_HOST.make_current()
    copy = tmp_path / "other_library"
    copy.write_bytes(WHEEL_HOST.path.read_bytes())
    other = make_job(scenario, library=copy)
    assert usual.key == key_of(scenario) != other.key
    same, again = run_jobs([usual, other], 1)
    assert same.figures["wire_sha256"] == again.figures["wire_sha256"]
    copy.write_bytes(copy.read_bytes() + b"another")
    with pytest.raises(LinkError, match="is not that of the job"):
        run_jobs([other], 1)
    copy.unlink()
    (gone,) = run_jobs([other], 1)
    assert (gone.status, gone.reason) == (
        REFUSED,
        f"file {copy}: it cannot be read (No such file or directory); a run needs it",
    )
    with pytest.raises(BadInputError, match="it cannot be read"):
        make_job(scenario, library=copy)


def test_a_worker_that_has_other_files_than_the_plan_ends_the_batch() -> None:
    job = make_job(of_mass(20.0))
    with pytest.raises(LinkError, match="or its FMU, law or reference file, is not that of the job"):
        run_jobs([job._replace(key="0" * 64)], 1)


def test_a_kind_and_its_options_are_part_of_a_key() -> None:
    scenario = of_mass(20.0)
    keys = {key_of(scenario), key_of(scenario, "module:function"), key_of(scenario, options={"signals": ["a"]})}
    assert len(keys) == 3


def test_outcomes_come_back_a_folder_as_they_were() -> None:
    outcome = Outcome("k", PASSED, None, {"a": 0.1}, {"extremes": {"s": [None, 1.0, 2.0, 0.1]}}, 0.5, None, "w")
    assert resumable._outcome(resumable._row(outcome)) == outcome


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="only Linux lists descriptors")
def test_a_life_line_of_a_child_that_cannot_be_started_is_closed() -> None:
    def descriptors() -> int:
        return len(list(Path("/proc/self/fd").iterdir()))

    before = descriptors()
    for _ in range(5):
        with pytest.raises(FileNotFoundError):
            LifeLine().start(["/nowhere/program"])
    assert descriptors() == before


@pytest.mark.skipif(sys.platform == "win32", reason="a LifeLine does nothing there")
def test_a_program_ends_with_a_process_that_is_killed_right_after_it_started_it() -> None:
    """The test is in the time before the program's own code runs, which a viewer's 0.1 s of loading make long."""
    starts = (
        "import os, signal; from hil.core.subprocesses import LifeLine;"
        "print(LifeLine().start_program(['/bin/sleep', '1000']).pid, flush=True); os.kill(os.getpid(), signal.SIGKILL)"
    )
    ended = subprocess.run([sys.executable, "-c", starts], capture_output=True, text=True, timeout=60)
    program = int(ended.stdout)
    wait_for(lambda: not is_running(program))
