"""The batch engine: a search goes by what came back and goes on from a store; a limit ends one job and no other."""

import contextlib
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

import hil
from hil.addons.batch import COMMANDS, pool
from hil.addons.batch.job import FAILED, IF_FAILED, LOST, PASSED, Job, Outcome, plain
from hil.addons.batch.keys import make_job
from hil.addons.batch.pool import run_jobs, run_plan
from hil.addons.batch.run import run
from hil.addons.batch.store import Store, read_rows
from hil.core.errors import LinkError
from hil.core.subprocesses import LifeLine
from hil.scenario import Scenario, load
from tests.support.addon_commands import flags_that_are_on
from tests.support.processes import is_running, wait_for

SHORT = {"loop.duration_s": 0.2, "loop.rate_hz": 200, "expect": []}
LAWS = """
import threading

from hil.core.types import WheelCommand, Wheels

REST = Wheels(0.0, 0.0, 0.0, 0.0)


class Rests:
    def __init__(self, model, mode):
        self.mode = mode

    def reset(self, state, reference):
        pass

    def update(self, reference, state, applied, dt_s):
        return WheelCommand(self.mode, REST, REST)


class Hangs(Rests):
    def update(self, reference, state, applied, dt_s):
        while True:
            pass


class Strays(Rests):
    def update(self, reference, state, applied, dt_s):
        print("what a law prints is no outcome")
        stray = threading.Thread(target=lambda: 1 / 0)
        stray.start()
        stray.join()
        return super().update(reference, state, applied, dt_s)
"""


def of_mass(mass_kg: float) -> Scenario:
    return load("circle_speed", set=SHORT | {"plant.start.mass_kg": mass_kg})


class Bisection:
    """A plan that looks for the least mass whose run takes less than an effort, to a tenth of a kilogram. In its first
    0.2 s a heavier robot is slower and needs less."""

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
    with Store(tmp_path) as store, contextlib.closing(run_plan(stopped, 1)) as some:
        while len(read_rows(tmp_path)) < 3:
            store.append([plain(outcome) for outcome in next(some)])
    known = {key: Outcome(**row) for key, row in read_rows(tmp_path).items()}
    search = Bisection(wanted)
    outcomes = [one for some in run_plan(search, 1, known) for one in some]
    assert search.low_kg < 19.3 <= search.high_kg
    assert search.high_kg - search.low_kg < 0.1
    assert [outcome.key in known for outcome in outcomes] == [True] * 3 + [False] * 4
    assert outcomes[:3] == [known[outcome.key] for outcome in outcomes[:3]], "what was known was not run again"
    assert {outcome.status for outcome in outcomes} == {PASSED}


def test_outcomes_are_in_the_order_of_the_jobs_and_equal_jobs_are_done_once(monkeypatch: pytest.MonkeyPatch) -> None:
    workers: list[subprocess.Popen[bytes]] = []

    class Noted(pool._Process):
        def __init__(self, kind: str) -> None:
            super().__init__(kind)
            workers.append(self._process)

    monkeypatch.setattr(pool, "_Process", Noted)
    masses_kg = (24.0, 16.0, 20.0, 16.0, 20.0)
    told: list[tuple[int, int]] = []
    jobs = [make_job(of_mass(mass_kg)) for mass_kg in masses_kg]
    outcomes = run_jobs(jobs, 2, lambda done, total, _: told.append((done, total)))
    assert [outcome.key for outcome in outcomes] == [job.key for job in jobs]
    efforts = [outcome.figures["effort_n_m_s"] for outcome in outcomes]
    assert efforts[1] == efforts[3] > efforts[2] == efforts[4] > efforts[0]
    assert told == [(1, 3), (2, 3), (3, 3)]
    assert [worker.poll() for worker in workers] == [0, 0], "none is left behind"
    assert run_jobs([]) == []


def test_a_job_of_another_kind_has_a_new_process_and_the_old_one_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    lives: list[list[str]] = []

    class Process:
        ended_why = None

        def __init__(self, kind: str) -> None:
            self.kind = kind
            lives.append([kind])

        def perform(self, job: Job) -> Outcome:
            lives[-1].append(job.key)
            return Outcome(job.key, PASSED, None)

        def close(self) -> None:
            lives[[life[0] for life in lives].index(self.kind)].append("closed")

    monkeypatch.setattr(pool, "_Process", Process)
    runner = pool.Runner()
    job = make_job(of_mass(20.0))
    for key, kind in (("1", "a"), ("2", "a"), ("3", "b")):
        assert runner.run(job._replace(key=key, kind=kind)).key == key
    runner.close()
    assert lives == [["a", "1", "2", "closed"], ["b", "3", "closed"]]


def test_no_flag_of_its_commands_is_on_by_itself() -> None:
    assert flags_that_are_on(COMMANDS) == []


def test_a_job_beyond_its_limit_or_with_an_error_in_a_thread_is_lost_and_the_next_is_done(tmp_path: Path) -> None:
    (tmp_path / "laws.py").write_text(LAWS, encoding="utf-8")
    hangs, strays, rests = (
        make_job(load("circle_speed", set=SHORT | {"controller.law": f"{tmp_path}/laws.py:{law}"}), limit_s=limit_s)
        for law, limit_s in (("Hangs", 2.0), ("Strays", 60.0), ("Rests", 60.0))
    )
    outcomes = run_jobs([hangs, strays, rests], 1)
    assert [outcome.status for outcome in outcomes] == [LOST, LOST, PASSED]
    assert outcomes[0].reason == "hung: it was ended after 2.0 s"
    line = 1 + LAWS[: LAWS.index("lambda: 1 / 0")].count("\n")
    assert outcomes[1].reason == f"traceback: ZeroDivisionError: division by zero at laws.py:{line}"
    assert 0.0 < outcomes[2].wall_s < outcomes[0].wall_s < 60.0
    assert not outcomes[0].figures


def test_a_run_that_failed_and_could_not_be_recorded_says_both(tmp_path: Path) -> None:
    beyond = {"signal": "error.planar_m", "below": 0.01}
    scenario = load("circle_speed", set=SHORT | {"expect": [beyond]})
    (tmp_path / "file").touch()
    outcome = run(make_job(scenario, record=IF_FAILED, recording=str(tmp_path / "file" / "run.rrd")), scenario)
    assert (outcome.status, outcome.recording) == (FAILED, None)
    why, _, not_recorded = str(outcome.reason).partition("; it could not be recorded: ")
    assert why.startswith("error.planar_m below 0.01 from 0 s to the end: failed, 0.5 at t = 0 s")
    assert "run.rrd" in not_recorded
    claim, *limits = outcome.details["claims"]
    assert claim["margin"] < 0.0
    assert claim["text"] == why
    assert {limit["margin"] for limit in limits} == {1.0}, "nothing that is limited happened"
    assert outcome.details["undriven"] is None


def test_a_worker_that_has_other_files_than_the_plan_ends_the_batch() -> None:
    job = make_job(of_mass(20.0))
    with pytest.raises(LinkError, match="an FMU, a law or a reference file of a run was changed"):
        run_jobs([job._replace(key="0" * 64)], 1)


def test_outcomes_come_back_from_a_folder_as_they_were(tmp_path: Path) -> None:
    outcome = Outcome("k", PASSED, None, {"a": 0.1}, {"extremes": {"s": [None, 1.0, 2.0, 0.1]}}, 0.5, None)
    with Store(tmp_path) as store:
        store.append([plain(outcome)])
    assert Outcome(**read_rows(tmp_path)["k"]) == outcome


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
