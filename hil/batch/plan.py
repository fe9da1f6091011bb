"""Plans, which say which jobs to do next (a fixed list, or a search by the outcomes), and the loop that does them."""

import contextlib
import itertools
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from typing import Protocol

from hil.batch.job import FOREIGN, Job, Outcome
from hil.batch.pool import LocalPool, Pool
from hil.core.errors import LinkError

OnProgress = Callable[[int, int, str | None], None]
"""A progress callback: it is called with (done, total, trouble) after each outcome; ``trouble`` is a sentence on the
newest one, or None when there is nothing to say."""


class Plan(Protocol):
    """Gives out jobs."""

    def next_jobs(self, outcomes: Sequence[Outcome], room: int) -> Sequence[Job]:
        """Return the next jobs, at most ``room``; ``outcomes`` are those since the last call.

        An empty list ends the plan if no job is running; otherwise it means: call again when some have finished.
        """


class FixedPlan:
    """A plan of listed jobs; they are taken as there is room, so the iterable may be long and lazy."""

    def __init__(self, jobs: Iterable[Job]) -> None:
        self._jobs = iter(jobs)

    def next_jobs(self, outcomes: Sequence[Outcome], room: int) -> Sequence[Job]:
        """Return the next jobs of the list."""
        return list(itertools.islice(self._jobs, room))


def run_plan(
    plan: Plan,
    pool: Pool,
    *,
    known: Mapping[str, Outcome] | None = None,
    on_trouble: Callable[[str | None], None] = lambda _: None,
    is_stopping: Callable[[], bool] = lambda: False,
) -> Generator[list[Outcome], None, None]:
    """Do a plan's jobs in a pool, and yield outcomes as they come, in any order. The pool is closed at the end.

    An empty list is yielded when for half a second none has come.

    A job whose key is in ``known`` is not done again: the known outcome is yielded, so a plan that was stopped
    continues where it was. ``on_trouble`` gets the pool's ``trouble`` at least twice a second. ``is_stopping`` is
    called as often: once it returns True, finished outcomes are yielded and the rest is dropped.

    Raises LinkError when a worker has other files or another version than the plan.
    """
    known = known or {}
    new: list[Outcome] = []
    with contextlib.closing(pool):
        while not is_stopping():
            room = pool.room()
            jobs = plan.next_jobs(new, room)
            for job in jobs:
                if job.key not in known:
                    pool.submit(job)
            new = [known[job.key] for job in jobs if job.key in known]
            if not new:
                if room > 0 and not pool.in_flight:
                    return
                new = _collected(pool)
            on_trouble(pool.trouble())
            yield new
        yield _collected(pool)


def _collected(pool: Pool) -> list[Outcome]:
    outcomes = pool.collect()
    for outcome in outcomes:
        if outcome.status == FOREIGN:
            raise LinkError(
                f"worker {outcome.worker}: its version of this package, or its FMU, law or reference file, is not that "
                "of the job; make them the same, and give the same command again"
            )
    return outcomes


def run_jobs(
    jobs: Sequence[Job],
    workers: int | None = None,
    on_progress: OnProgress | None = None,
    trouble: Callable[[Outcome], str | None] = lambda _: None,
) -> list[Outcome]:
    """Do jobs in processes on this machine and return their outcomes in the order of the jobs.

    Jobs with the same key are done once. ``workers`` is the number of processes, by default one per processor;
    ``trouble`` gives the sentence for the progress callback.
    """
    unique = {job.key: job for job in jobs}
    outcomes: dict[str, Outcome] = {}
    for new in run_plan(FixedPlan(unique.values()), LocalPool(workers)):
        for outcome in new:
            outcomes[outcome.key] = outcome
            if on_progress is not None:
                on_progress(len(outcomes), len(unique), trouble(outcome))
    return [outcomes[job.key] for job in jobs]
