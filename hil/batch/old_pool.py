"""Worker processes that do many jobs each, and a hang guard: a job that takes too long is ended with its worker."""

import itertools
import json
import queue
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import IO, Any, Generic, Protocol, TypeVar

from hil.core.subprocesses import away_from_terminal, module_command
from hil.record.environment import rerun_environment

READY = "ready\n"
"""What a worker says first, when all is imported: a job's time begins later."""
_START_S = 120.0
_END_S = 10.0


class Plain(Protocol):
    """A NamedTuple of plain values: it goes to another process as JSON."""

    def _asdict(self) -> dict[str, Any]: ...


J = TypeVar("J", bound=Plain)
A = TypeVar("A", bound=Plain)


@dataclass(frozen=True)
class Work(Generic[J, A]):
    """A kind of job.

    Attributes:
        worker: the module whose process does the jobs, by ``hil.batch.worker.serve``.
        answer: makes an answer of its fields by name.
        lost: the answer for a job that told nothing, from what became of it and the wall-clock time [s] it took.
    """

    worker: str
    answer: Callable[..., A]
    lost: Callable[[J, str, float], A]


def counted(tell: Callable[[int, int, A], None] | None, of: int) -> Callable[[A], None]:
    """Return what tells of each answer with how many there are by then, and of how many; None to tell nobody."""
    numbers = itertools.count(1)

    def count(answer: A) -> None:
        if tell is not None:
            tell(next(numbers), of, answer)

    return count


def perform_all(
    work: Work[J, A], jobs: Sequence[J], workers: int, limit_s: float, tell: Callable[[A], None] = lambda _: None
) -> list[A]:
    """Do the jobs in so many processes and return the answers in the order of the jobs.

    A job that takes more than ``limit_s`` of wall-clock time is ended: it is lost, with words that begin with "hung".
    One whose process ends by itself, does not begin, or gives no answer is lost with words that begin with "crashed".
    ``tell`` gets each answer as it comes.
    """
    waiting: queue.SimpleQueue[tuple[int, J]] = queue.SimpleQueue()
    for numbered in enumerate(jobs):
        waiting.put(numbered)
    done: queue.SimpleQueue[tuple[int, A]] = queue.SimpleQueue()
    hands = [_Hand(work, waiting, done, limit_s) for _ in range(min(workers, len(jobs)))]
    answers: dict[int, A] = {}
    try:
        while len(answers) < len(jobs):
            number, answer = done.get()
            answers[number] = answer
            tell(answer)
    except BaseException:
        for hand in hands:
            hand.abort()
        raise
    finally:
        for hand in hands:
            hand.join()
    return [answers[number] for number in range(len(jobs))]


class _Worker:
    """One worker process."""

    def __init__(self, module: str) -> None:
        self._words: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 -- closed in close()
        self._process = subprocess.Popen(
            module_command(module),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._words,
            env=rerun_environment(),
            **away_from_terminal(),
        )
        self._is_ready = False
        self.ended_after_s: float | None = None

    def perform(self, job: Plain, limit_s: float) -> dict[str, Any] | None:
        """Do a job and return its answer as fields; None when the process has ended, by itself or by the guard."""
        assert self._process.stdin is not None
        if not self._is_ready:
            self._is_ready = self._line(_START_S).strip() == READY.strip().encode()
            if not self._is_ready:
                return None
        try:
            self._process.stdin.write(json.dumps(job._asdict()).encode() + b"\n")
            self._process.stdin.flush()
        except OSError:
            return None
        line = self._line(limit_s)
        if not line.endswith(b"\n"):
            return None
        fields: dict[str, Any] = json.loads(line)
        return fields

    def _line(self, limit_s: float) -> bytes:
        """Return its next line, and less when it ends; after so long it is ended, which ``ended_after_s`` tells."""
        assert self._process.stdout is not None

        def end() -> None:
            self.ended_after_s = limit_s
            self._process.kill()

        guard = threading.Timer(limit_s, end)
        guard.start()
        try:
            return bytes(self._process.stdout.readline())
        except OSError:
            return b""
        finally:
            guard.cancel()

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


class Performer(Generic[J, A]):
    """Does jobs one after the other in a worker process, which is started when it is needed, and anew after its end."""

    def __init__(self, work: Work[J, A], limit_s: float) -> None:
        self._work = work
        self._limit_s = limit_s
        self._worker: _Worker | None = None

    def perform(self, job: J) -> A:
        """Do a job; whatever goes wrong is an answer, for without one nobody would stop waiting."""
        began = time.monotonic()
        try:
            return self._perform_or_raise(job)
        except Exception as error:  # noqa: BLE001 -- no process can be made, an answer that cannot be read, ...
            self.kill()
            self.close()
            return self._work.lost(job, f"crashed: {type(error).__name__}: {error}", time.monotonic() - began)

    def _perform_or_raise(self, job: J) -> A:
        self._worker = self._worker or _Worker(self._work.worker)
        began = time.monotonic()
        fields = self._worker.perform(job, self._limit_s)
        if fields is not None:
            return self._work.answer(**fields)
        wall_s, ended_after_s = time.monotonic() - began, self._worker.ended_after_s
        trouble = self._worker.trouble()
        self.close()
        how = f"crashed: {trouble}" if ended_after_s is None else f"hung: it was ended after {ended_after_s:.1f} s"
        return self._work.lost(job, how, wall_s)

    def kill(self) -> None:
        """End the process at once; may be called from another thread."""
        if (worker := self._worker) is not None:
            worker.kill()

    def close(self) -> None:
        """End the process when it has done its job."""
        if (worker := self._worker) is not None:
            self._worker = None
            worker.close()


class _Hand(Generic[J, A]):
    """A thread that has jobs done, as long as there are any."""

    def __init__(
        self,
        work: Work[J, A],
        waiting: "queue.SimpleQueue[tuple[int, J]]",
        done: "queue.SimpleQueue[tuple[int, A]]",
        limit_s: float,
    ) -> None:
        self._performer = Performer(work, limit_s)
        self._waiting = waiting
        self._done = done
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="pool", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._closing:
            try:
                number, job = self._waiting.get_nowait()
            except queue.Empty:
                break
            self._done.put((number, self._performer.perform(job)))
        self._performer.close()

    def abort(self) -> None:
        """Leave the other jobs, and the one in hand."""
        self._closing = True
        self._performer.kill()

    def join(self) -> None:
        """Wait until the worker has ended."""
        self._thread.join()
