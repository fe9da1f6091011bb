"""Giving runs to the workers and taking what came of them, whatever becomes of the workers and their scheduler."""

import contextlib
import itertools
import queue
import time
from collections.abc import Callable, Generator, Iterator
from typing import Any, NamedTuple

import distributed
from distributed.client import FutureCancelledError

from hil.batch.campaign.cluster import BENCH, Answer, Place, RunProcesses, cluster, connect, perform_on_worker, prepare
from hil.batch.campaign.jobs import Job
from hil.batch.campaign.rows import LOST, Said
from hil.core.errors import LinkError

_AHEAD = 2
"""Runs that a worker has waiting beside the one in hand: so many are lost with a scheduler, and none waits for us."""
_LEAST_AHEAD = 4
_POLL_S = 0.5
_ASK_AGAIN_S = 2.0
_PATIENCE_S = 300.0
_GATHER_S = 60.0


class Done(NamedTuple):
    """A run that is done."""

    job: Job
    answer: Answer


class Told(NamedTuple):
    """What may be said meanwhile: of how many workers there are, and what is waited for, if something is."""

    workers: int
    trouble: str | None


def perform_jobs(
    place: Place,
    jobs: Iterator[Job],
    *,
    on_bench: bool,
    tell: Callable[[Told], None] = lambda _: None,
    is_stopping: Callable[[], bool] = lambda: False,
    patience_s: float = _PATIENCE_S,
) -> Generator[list[Done]]:
    """Do the jobs, at most a few a worker at a time, and yield what is done as it comes, in any order.

    ``on_bench`` has them done where the resource ``bench`` is. A job whose worker is lost is done by another, one that
    Dask gives up is lost. When the scheduler goes, its runs are given anew once it is back. When ``is_stopping`` says
    so, what is done is yielded, and the rest left; it is asked twice a second.

    Raises LinkError when no scheduler answers, or none came back within ``patience_s``.
    """
    with cluster(place) as to:
        hands = _Hands(to, place, on_bench=on_bench)
        try:
            yield from _perform(hands, jobs, tell, is_stopping, patience_s)
        finally:
            hands.close()


def _perform(
    hands: "_Hands",
    jobs: Iterator[Job],
    tell: Callable[[Told], None],
    is_stopping: Callable[[], bool],
    patience_s: float,
) -> Iterator[list[Done]]:
    again: list[Job] = []
    lost_s: float | None = None
    while not is_stopping():
        if hands.is_ready():
            lost_s = None
            for job in itertools.islice(itertools.chain(_taken(again), jobs), hands.room()):
                hands.give(job)
        else:
            lost_s = lost_s or time.monotonic()
            if time.monotonic() - lost_s > patience_s:
                raise LinkError(
                    f"--scheduler {hands.address}: it has gone, and did not come back within {patience_s:g} s; "
                    "give the same command again when it is there, and the campaign goes on"
                )
            hands.reconnect()
        done, left = hands.take()
        again += left
        tell(hands.told())
        if done:
            yield done
        if not hands.in_flight and not again:
            if (job_left := next(jobs, None)) is None:
                return
            again.append(job_left)
    done, _ = hands.take()
    yield done


def _taken(jobs: list[Job]) -> Iterator[Job]:
    while jobs:
        yield jobs.pop()


class _Hands:
    """The runs that are with Dask now."""

    def __init__(self, to: Any, place: Place, *, on_bench: bool) -> None:
        self._to = to
        self._processes = RunProcesses(place.limit_s)
        self._resources = {BENCH: 1} if on_bench else None
        self._client: distributed.Client | None = connect(to)
        self._is_prepared = False
        self._jobs: dict[str, tuple[Job, distributed.Future[Answer | None]]] = {}
        self._finished: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._numbers = itertools.count()
        self._threads = 0
        self._asked_s = -_ASK_AGAIN_S

    @property
    def address(self) -> str:
        """Where the scheduler is."""
        return self._to if isinstance(self._to, str) else "of this machine"

    @property
    def in_flight(self) -> int:
        """How many runs are with Dask."""
        return len(self._jobs)

    @property
    def _is_connected(self) -> bool:
        return self._client is not None and self._client.status == "running"

    def is_ready(self) -> bool:
        """Return whether there is a scheduler whose workers have our processes: another one does not know of them."""
        if self._client is None or not self._is_connected:
            return False
        if not self._is_prepared:
            with contextlib.suppress(OSError):  # it goes just now
                prepare(self._client, self._processes)
                self._is_prepared = True
        return self._is_prepared

    def told(self) -> Told:
        """Return what may be said."""
        if not self._is_connected:
            return Told(0, f"the scheduler {self.address} has gone; waiting for it")
        workers = self._workers()
        if not workers:
            needed = f" with --resources {BENCH}=1" if self._resources else ""
            return Told(workers, f"the scheduler {self.address} has no worker{needed}; waiting for one")
        return Told(workers, None)

    def room(self) -> int:
        """Return how many more runs may be given."""
        return max(0, max(_LEAST_AHEAD, (1 + _AHEAD) * self._workers()) - len(self._jobs))

    def _workers(self) -> int:
        """Return the threads of the workers that can do runs, as they were a moment ago: to ask is a round trip."""
        now_s = time.monotonic()
        if self._client is None or now_s - self._asked_s < _ASK_AGAIN_S:
            return self._threads
        self._asked_s = now_s
        try:
            workers = self._client.scheduler_info(n_workers=-1)["workers"].values()
        except OSError:  # it goes just now, which is seen to next
            return self._threads
        able = (one for one in workers if self._resources is None or BENCH in one.get("resources", {}))
        self._threads = sum(worker["nthreads"] for worker in able)
        return self._threads

    def give(self, job: Job) -> None:
        """Give a run to the scheduler."""
        assert self._client is not None
        # A name of its own: Dask would take another run of this name for the same.
        name = f"run-{job.key[:16]}-{next(self._numbers)}"
        processes = self._processes.name
        future = self._client.submit(perform_on_worker, processes, job, key=name, pure=False, resources=self._resources)
        self._jobs[name] = (job, future)
        future.add_done_callback(lambda _: self._finished.put(name))

    def take(self) -> tuple[list[Done], list[Job]]:
        """Wait a little for runs that are done; return them, and those that have to be given anew."""
        done: list[Done] = []
        left: list[Job] = []
        names = []
        with contextlib.suppress(queue.Empty):
            names.append(self._finished.get(timeout=_POLL_S))
            while True:
                names.append(self._finished.get_nowait())
        for name in names:
            job, future = self._jobs.pop(name)
            answer = _answer(future)
            if answer is None:
                left.append(job)
                self._is_prepared = False
            else:
                done.append(Done(job, answer))
        return done, left

    def reconnect(self) -> None:
        """Try to have a scheduler again: the client does so by itself for a while, and closes then."""
        if self._client is not None and self._client.status != "closed":
            return
        self._client = None
        with contextlib.suppress(LinkError):
            self._client = connect(self._to)
            self._is_prepared = False

    def close(self) -> None:
        """Leave what is not done, and end our processes, which an existing cluster would keep otherwise."""
        if self._client is None:
            return
        with contextlib.suppress(Exception):  # the scheduler may be gone, and nothing is to be said of that any more
            self._client.cancel([future for _, future in self._jobs.values()], force=True)
            if self._is_connected:
                self._client.unregister_worker_plugin(self._processes.name)
        self._client.close(timeout=2.0)


def _answer(future: "distributed.Future[Answer | None]") -> Answer | None:
    """Return what came of a run, or None when it has to be given anew.

    Raises LinkError when the worker could not do it: anew it would be the same.
    """
    if future.status in ("cancelled", "lost"):
        return None
    is_error = future.status == "error"
    try:
        answer: Answer | None = future.result(timeout=_GATHER_S)
    except distributed.KilledWorker as error:
        words = f"every worker of Dask that had it was lost, {error.allowed_failures + 1} of them"
        return Answer(Said({}, LOST, words, 0.0), "-", None)
    except FutureCancelledError:
        return None
    except (TimeoutError, OSError) as error:
        if is_error:  # the run's own, not that of the way here
            raise LinkError(
                f"a worker of Dask cannot do runs: {error}; make room for temporary files there, or make their folder "
                "writable, and give the same command again"
            ) from error
        return None
    return answer
