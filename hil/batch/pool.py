"""Pools, which do jobs: by default in worker processes on this machine.

A worker process does many jobs, so imports and the opening of an FMU are paid once. A job that takes too long, or too
much memory, is ended with its process; it is lost, and the next job gets a new process.
"""

import contextlib
import json
import os
import queue
import socket
import subprocess
import tempfile
import threading
import time
from typing import IO, Protocol, TypeVar

from hil.batch.job import LOST, Job, Outcome, plain
from hil.core import mutant as mutants
from hil.core.subprocesses import LifeLine, away_from_terminal, excess, module_command
from hil.record.started_process import rerun_environment

READY = "ready\n"
"""A worker process writes this after its imports; only then the time limit of its first job begins."""
MODULE = "hil.batch.worker"
_START_S = 120.0
_END_S = 10.0
_LOOK_S = 0.2
COLLECT_S = 0.5
_AHEAD = 1
"""Jobs queued per worker besides the running one, so that no worker waits for the next."""


T = TypeVar("T")


def drain(source: "queue.SimpleQueue[T]", wait_s: float = 0.0) -> list[T]:
    """Return all that a queue holds; wait up to ``wait_s`` for the first item."""
    found = []
    with contextlib.suppress(queue.Empty):
        found.append(source.get(timeout=wait_s))
        while True:
            found.append(source.get_nowait())
    return found


class Pool(Protocol):
    """Does jobs. Nothing is raised for a job: whatever goes wrong with one is its outcome."""

    @property
    def in_flight(self) -> int:
        """How many jobs were submitted and not collected yet."""

    def room(self) -> int:
        """Return how many more jobs may be submitted now."""

    def submit(self, job: Job) -> None:
        """Queue a job."""

    def collect(self) -> list[Outcome]:
        """Wait up to half a second for outcomes, and return all that there are."""

    def trouble(self) -> str | None:
        """Return a sentence on what the pool waits for, or None."""

    def close(self) -> None:
        """End the workers, and with them the jobs that are still under way."""


class LocalPool:
    """A pool of processes on this machine; ``workers`` is how many at most, by default one per processor.

    A process is started only when there is a job for it.
    """

    def __init__(self, workers: int | None = None) -> None:
        self._workers = workers or os.cpu_count() or 1
        self._waiting: queue.SimpleQueue[Job | None] = queue.SimpleQueue()
        self._done: queue.SimpleQueue[Outcome] = queue.SimpleQueue()
        self._threads: list[tuple[threading.Thread, Runner]] = []
        self.in_flight = 0

    def room(self) -> int:
        return (1 + _AHEAD) * self._workers - self.in_flight

    def submit(self, job: Job) -> None:
        self._waiting.put(job)
        self.in_flight += 1
        if len(self._threads) < min(self._workers, self.in_flight):
            runner, name = Runner(), f"{socket.gethostname()} {len(self._threads)}"
            thread = threading.Thread(target=self._serve, args=(runner, name), name="pool", daemon=True)
            self._threads.append((thread, runner))
            thread.start()

    def _serve(self, runner: "Runner", name: str) -> None:
        while (job := self._waiting.get()) is not None:
            self._done.put(runner.run(job)._replace(worker=name))
        runner.close()

    def collect(self) -> list[Outcome]:
        outcomes = drain(self._done, COLLECT_S)
        self.in_flight -= len(outcomes)
        return outcomes

    def trouble(self) -> None:
        return None

    def close(self) -> None:
        drain(self._waiting)
        for _, runner in self._threads:
            self._waiting.put(None)
            if self.in_flight:
                runner.kill()
        for thread, _ in self._threads:
            thread.join()


class Runner:
    """Does jobs one after the other in a worker process, which is started when needed, and again after it has ended."""

    def __init__(self) -> None:
        self._process: _Process | None = None
        self.is_ending = False
        """Whether ``kill`` was called."""

    def run(self, job: Job) -> Outcome:
        """Do a job; after a crash once more if it has ``retries_crash``, unless ``kill`` was called."""
        outcome, has_crashed = self._try(job)
        if has_crashed and job.retries_crash and not self.is_ending:
            outcome, _ = self._try(job)
            if outcome.status == LOST:
                return outcome._replace(reason=f"its process ended twice, at last: {outcome.reason}")
        return outcome

    def _try(self, job: Job) -> tuple[Outcome, bool]:
        """Return the outcome, and whether it is a crash: the process was not ended for a limit."""
        began = time.monotonic()
        limit: str | None = None
        try:
            if self._process is not None and self._process.made_for != _made_for(job):
                self.close()
            process = self._process = self._process or _Process(job)
            if self.is_ending:
                process.kill()
            outcome = process.perform(job)
            if outcome is not None:
                return outcome, False
            limit = process.ended_why
            reason = limit or f"crashed: {process.last_words()}"
        except Exception as error:  # noqa: BLE001 -- no process can be made, an answer cannot be read, ...
            self._kill()
            reason = f"crashed: {type(error).__name__}: {error}"
        self.close()
        return Outcome(job.key, LOST, reason, wall_s=time.monotonic() - began), limit is None

    def kill(self) -> None:
        """End the process at once and try nothing again; may be called from another thread."""
        self.is_ending = True
        self._kill()

    def _kill(self) -> None:
        if (process := self._process) is not None:
            process.kill()

    def close(self) -> None:
        """End the process when it has done its job."""
        if (process := self._process) is not None:
            self._process = None
            process.close()


def _made_for(job: Job) -> tuple[object, ...]:
    return job.kind, job.library, job.options.get("mutant"), job.options.get("process")


class _Process:
    """One worker process; ``made_for`` is what the jobs that it can do have in common."""

    def __init__(self, job: Job) -> None:
        self.made_for = _made_for(job)
        self._stderr: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 -- closed in close()
        library = {} if job.library is None else {"WHEEL_HOST_LIBRARY": job.library}
        mutant = {mutants.VARIABLE: job.options["mutant"]} if job.options.get("mutant") else {}
        self._life_line = LifeLine()
        self._process = self._life_line.start(
            module_command(MODULE, job.kind, self._life_line.token),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._stderr,
            env=rerun_environment() | library | mutant,
            **away_from_terminal(),
        )
        self._is_ready = False
        self.ended_why: str | None = None
        self._limits: tuple[float, float, float | None] | None = None  # of the line that is awaited: end, s, MB
        self._lock = threading.Lock()  # between a line that comes and a limit that is passed
        self._closing = threading.Event()
        threading.Thread(target=self._guard, name="job limits", daemon=True).start()

    def perform(self, job: Job) -> Outcome | None:
        """Do a job and return its outcome; None when the process has ended, by itself or for a limit."""
        assert self._process.stdin is not None
        if not self._is_ready:
            self._is_ready = self._line(_START_S, None).strip() == READY.strip().encode()
            if not self._is_ready:
                return None
        try:
            self._process.stdin.write(json.dumps(plain(job)).encode() + b"\n")
            self._process.stdin.flush()
        except OSError:
            return None
        line = self._line(job.limit_s, job.memory_mb)
        return Outcome(**json.loads(line)) if line.endswith(b"\n") and self.ended_why is None else None

    def _line(self, limit_s: float, memory_mb: float | None) -> bytes:
        """Return the process's next line, or less when it ends; at a limit it is ended and ``ended_why`` is set."""
        assert self._process.stdout is not None
        self._limits = time.monotonic() + limit_s, limit_s, memory_mb
        try:
            return bytes(self._process.stdout.readline())
        except OSError:
            return b""
        finally:
            with self._lock:
                self._limits = None

    def _guard(self) -> None:
        """End the process when a line takes too long, or too much memory; the body of a thread.

        It looks now and then for as long as the process lives: a thread for each line costs more than all else.
        """
        while self.ended_why is None and not self._closing.wait(_LOOK_S):
            with self._lock:
                if self._limits is None:
                    continue
                end, limit_s, memory_mb = self._limits
                if memory_mb is not None:
                    self.ended_why = excess(self._process.pid, memory_mb)
                if time.monotonic() >= end:
                    self.ended_why = f"hung: it was ended after {limit_s:.1f} s"
                if self.ended_why is not None:
                    self._process.kill()

    def last_words(self) -> str:
        """Return how the process ended, with the last line it wrote to stderr."""
        code = self._process.wait()
        self._stderr.seek(0)
        lines = self._stderr.read().decode("utf-8", "replace").strip().splitlines()
        return f"exit code {code}{': ' + lines[-1] if lines else ''}"

    def close(self) -> None:
        """Close the process's stdin, which ends it; if it does not end, kill it."""
        self._closing.set()
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
