"""Worker processes that do many runs each, and a hang guard: a run that takes too long is ended with its worker."""

import json
import queue
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from typing import IO

from hil.catalogue.runs import Job, Verdict, lost
from hil.child import away_from_terminal, module_command
from hil.telemetry.environment import rerun_environment

_END_S = 10.0


def perform_all(
    jobs: Sequence[Job], workers: int, limit_s: float, tell: Callable[[Verdict], None] = lambda _: None
) -> list[Verdict]:
    """Do the jobs in so many processes and return the verdicts in the order of the jobs.

    A run that takes more than ``limit_s`` of wall-clock time is ended: its verdict begins with "hung". One whose
    process ends by itself, does not begin, or answers with no verdict gets one that begins with "crashed". ``tell``
    gets each verdict as it comes.
    """
    waiting: queue.SimpleQueue[tuple[int, Job]] = queue.SimpleQueue()
    for numbered in enumerate(jobs):
        waiting.put(numbered)
    done: queue.SimpleQueue[tuple[int, Verdict]] = queue.SimpleQueue()
    hands = [_Hand(waiting, done, limit_s) for _ in range(min(workers, len(jobs)))]
    verdicts: dict[int, Verdict] = {}
    try:
        while len(verdicts) < len(jobs):
            number, verdict = done.get()
            verdicts[number] = verdict
            tell(verdict)
    except BaseException:
        for hand in hands:
            hand.abort()
        raise
    finally:
        for hand in hands:
            hand.join()
    return [verdicts[number] for number in range(len(jobs))]


class _Worker:
    """One worker process."""

    def __init__(self) -> None:
        self._words: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 -- closed in close()
        self._process = subprocess.Popen(
            module_command("hil.catalogue.worker"),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._words,
            env=rerun_environment(),
            **away_from_terminal(),
        )

    def perform(self, job: Job, limit_s: float) -> Verdict | None:
        """Do a job; None when the process has ended, by itself or because it took too long."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        guard = threading.Timer(limit_s, self._process.kill)
        guard.start()
        try:
            self._process.stdin.write(json.dumps(job._asdict()).encode() + b"\n")
            self._process.stdin.flush()
            line = self._process.stdout.readline()
        except OSError:
            line = b""
        finally:
            guard.cancel()
        return Verdict(**json.loads(line)) if line.endswith(b"\n") else None

    def trouble(self) -> str:
        """Return how the process ended, with its last words."""
        code = self._process.wait()
        self._words.seek(0)
        words = self._words.read().decode("utf-8", "replace").strip().splitlines()
        return f"exit code {code}{': ' + words[-1] if words else ''}"

    def close(self) -> None:
        """End the process; one that does not leave by itself is ended."""
        assert self._process.stdin is not None
        try:
            self._process.communicate(timeout=_END_S)
        except (subprocess.TimeoutExpired, OSError, ValueError):
            self._process.kill()
            self._process.wait()
        self._words.close()

    def kill(self) -> None:
        """End the process at once."""
        self._process.kill()


class _Hand:
    """A thread that gives one worker at a time its jobs, and starts another where that has ended."""

    def __init__(
        self,
        waiting: "queue.SimpleQueue[tuple[int, Job]]",
        done: "queue.SimpleQueue[tuple[int, Verdict]]",
        limit_s: float,
    ) -> None:
        self._waiting = waiting
        self._done = done
        self._limit_s = limit_s
        self._closing = False
        self._worker: _Worker | None = None
        self._thread = threading.Thread(target=self._run, name="catalogue", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._closing:
            try:
                number, job = self._waiting.get_nowait()
            except queue.Empty:
                break
            self._done.put((number, self._perform(job)))
        self._dismiss()

    def _dismiss(self) -> None:
        if (worker := self._worker) is not None:
            self._worker = None
            worker.close()

    def _perform(self, job: Job) -> Verdict:
        """Do a job; whatever goes wrong is a verdict, for without one nobody would stop waiting."""
        began = time.monotonic()
        try:
            return self._perform_or_raise(job)
        except Exception as error:  # noqa: BLE001 -- no process can be made, an answer that cannot be read, ...
            if (worker := self._worker) is not None:
                worker.kill()
            self._dismiss()
            return lost(job, f"crashed: {type(error).__name__}: {error}", time.monotonic() - began)

    def _perform_or_raise(self, job: Job) -> Verdict:
        self._worker = self._worker or _Worker()
        began = time.monotonic()
        verdict = self._worker.perform(job, self._limit_s)
        if verdict is not None:
            return verdict
        wall_s = time.monotonic() - began
        trouble = self._worker.trouble()
        self._dismiss()
        how = f"hung: it was ended after {wall_s:.1f} s" if wall_s >= self._limit_s else f"crashed: {trouble}"
        return lost(job, how, wall_s)

    def abort(self) -> None:
        """Leave the other jobs, and the one in hand."""
        self._closing = True
        if (worker := self._worker) is not None:
            worker.kill()

    def join(self) -> None:
        """Wait until the worker has ended."""
        self._thread.join()
