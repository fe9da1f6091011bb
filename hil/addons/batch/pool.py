"""Does the jobs of a plan in worker processes on this machine.

A worker process does many jobs, so imports and the opening of an FMU are paid once. A job that takes too long is ended
with its process; it is lost, and the next job gets a new process.
"""

import concurrent.futures
import itertools
import json
import os
import queue
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from typing import IO, Protocol

from hil.addons.batch.job import FOREIGN, LOST, Job, Outcome, plain
from hil.core.errors import LinkError
from hil.core.subprocesses import LifeLine, away_from_terminal, module_command
from hil.record.started_process import rerun_environment

READY = "ready\n"
"""A worker process writes this after its imports; only then the time limit of its first job begins."""
MODULE = "hil.addons.batch.worker"
_START_S = 120.0
_END_S = 10.0
_LOOK_S = 0.5
_AHEAD = 1
"""Jobs queued per worker besides the running one, so that no worker waits for the next."""

OnProgress = Callable[[int, int, str | None], None]
"""A progress callback: it is called with (done, total, trouble) after each outcome; ``trouble`` is a sentence on the
newest one, or None when there is nothing to say."""


class Plan(Protocol):
    """Gives out jobs."""

    def next_jobs(self, outcomes: Sequence[Outcome], room: int) -> Sequence[Job]:
        """Return the next jobs, at most ``room``; ``outcomes`` are those since the last call.

        An empty list ends the plan if no job is running; otherwise it means: call again when some have finished.
        """


class Listed:
    """A plan of listed jobs; they are taken as there is room, so the iterable may be long and lazy."""

    def __init__(self, jobs: Iterable[Job]) -> None:
        self._jobs = iter(jobs)

    def next_jobs(self, outcomes: Sequence[Outcome], room: int) -> Sequence[Job]:
        """Return the next jobs of the list."""
        return list(itertools.islice(self._jobs, room))


def run_plan(
    plan: Plan, workers: int | None = None, known: Mapping[str, Outcome] | None = None
) -> Generator[list[Outcome], None, None]:
    """Do a plan's jobs, and yield outcomes as they come, in any order; an empty list when for half a second none has.

    ``workers`` is the number of processes, by default one per processor; each is started when there is a job for it. A
    job whose key is in ``known`` is not done again: its known outcome is yielded, so a stopped plan continues. When the
    generator is closed, the jobs under way are ended.

    Raises LinkError when a worker has other files than the plan. Nothing is raised for a job: whatever goes wrong with
    one is its outcome.
    """
    known = known or {}
    count = workers or os.cpu_count() or 1
    runners = [Runner() for _ in range(count)]
    idle: queue.LifoQueue[Runner] = queue.LifoQueue()
    for runner in reversed(runners):
        idle.put(runner)

    def done(job: Job) -> Outcome:
        runner = idle.get()
        try:
            return runner.run(job)
        finally:
            idle.put(runner)

    running: set[concurrent.futures.Future[Outcome]] = set()
    new: list[Outcome] = []
    try:
        with concurrent.futures.ThreadPoolExecutor(count, "pool") as threads:
            try:
                while True:
                    jobs = plan.next_jobs(new, (1 + _AHEAD) * count - len(running))
                    running |= {threads.submit(done, job) for job in jobs if job.key not in known}
                    new = [known[job.key] for job in jobs if job.key in known]
                    if not new:
                        if not running:
                            return
                        ended, running = concurrent.futures.wait(running, _LOOK_S, concurrent.futures.FIRST_COMPLETED)
                        new = [_current(future.result()) for future in ended]
                    yield new
            finally:
                for future in running:
                    future.cancel()
                for runner in runners if running else ():
                    runner.kill()
    finally:
        for runner in runners:
            runner.close()


def _current(outcome: Outcome) -> Outcome:
    if outcome.status == FOREIGN:
        raise LinkError(
            "an FMU, a law or a reference file of a run was changed since it was planned; give the same command again"
        )
    return outcome


def run_jobs(
    jobs: Sequence[Job],
    workers: int | None = None,
    on_progress: OnProgress | None = None,
    trouble: Callable[[Outcome], str | None] = lambda _: None,
) -> list[Outcome]:
    """Do jobs and return their outcomes in the order of the jobs; ``workers`` as in ``run_plan``.

    Jobs with the same key are done once. ``trouble`` gives the sentence for the progress callback.
    """
    unique = {job.key: job for job in jobs}
    outcomes: dict[str, Outcome] = {}
    for new in run_plan(Listed(unique.values()), workers):
        for outcome in new:
            outcomes[outcome.key] = outcome
            if on_progress is not None:
                on_progress(len(outcomes), len(unique), trouble(outcome))
    return [outcomes[job.key] for job in jobs]


class Runner:
    """Does jobs one after the other in a worker process, which is started when needed, and again after it has ended."""

    def __init__(self) -> None:
        self._process: _Process | None = None
        self._is_ending = False

    def run(self, job: Job) -> Outcome:
        """Do a job; when its process ends meanwhile, by itself or for the limit, it is lost."""
        began = time.monotonic()
        try:
            if self._process is not None and self._process.kind != job.kind:
                self.close()
            process = self._process = self._process or _Process(job.kind)
            if self._is_ending:
                process.kill()
            outcome = process.perform(job)
            if outcome is not None:
                return outcome
            reason = process.ended_why or f"crashed: {process.last_words()}"
        except Exception as error:  # noqa: BLE001 -- no process can be made, an answer cannot be read, ...
            if self._process is not None:
                self._process.kill()
            reason = f"crashed: {type(error).__name__}: {error}"
        self.close()
        return Outcome(job.key, LOST, reason, wall_s=time.monotonic() - began)

    def kill(self) -> None:
        """End the process at once, and each further one; may be called from another thread."""
        self._is_ending = True
        if (process := self._process) is not None:
            process.kill()

    def close(self) -> None:
        """End the process when it has done its job."""
        if (process := self._process) is not None:
            self._process = None
            process.close()


class _Process:
    """One worker process, for jobs of one kind."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self._stderr: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 -- closed in close()
        self._life_line = LifeLine()
        self._process = self._life_line.start(
            module_command(MODULE, kind, self._life_line.token),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._stderr,
            env=rerun_environment(),
            **away_from_terminal(),
        )
        self._is_ready = False
        self.ended_why: str | None = None

    def perform(self, job: Job) -> Outcome | None:
        """Do a job and return its outcome; None when the process has ended, by itself or for the limit."""
        assert self._process.stdin is not None
        if not self._is_ready:
            self._is_ready = self._line(_START_S).strip() == READY.strip().encode()
            if not self._is_ready:
                return None
        try:
            self._process.stdin.write(json.dumps(plain(job)).encode() + b"\n")
            self._process.stdin.flush()
        except OSError:
            return None
        line = self._line(job.limit_s)
        return Outcome(**json.loads(line)) if line.endswith(b"\n") and self.ended_why is None else None

    def _line(self, limit_s: float) -> bytes:
        """Return the process's next line, or less when it ends; at the limit it is ended and ``ended_why`` is set."""
        assert self._process.stdout is not None

        def end() -> None:
            self.ended_why = f"hung: it was ended after {limit_s:.1f} s"
            self._process.kill()

        timer = threading.Timer(limit_s, end)
        timer.daemon = True
        timer.start()
        try:
            return bytes(self._process.stdout.readline())
        except OSError:
            return b""
        finally:
            timer.cancel()
            timer.join()  # so that it ends no later job

    def last_words(self) -> str:
        """Return how the process ended, with the last line it wrote to stderr."""
        code = self._process.wait()
        self._stderr.seek(0)
        lines = self._stderr.read().decode("utf-8", "replace").strip().splitlines()
        return f"exit code {code}{': ' + lines[-1] if lines else ''}"

    def close(self) -> None:
        """Close the process's stdin, which ends it; if it does not end, kill it."""
        try:
            self._process.communicate(timeout=_END_S)
        except (subprocess.TimeoutExpired, OSError, ValueError):
            self._process.kill()
            self._process.wait()
        self._life_line.close()
        self._stderr.close()

    def kill(self) -> None:
        """End the process at once."""
        self._process.kill()
