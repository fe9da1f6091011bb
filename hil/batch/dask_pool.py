"""A pool on an existing cluster of Dask (``--scheduler``). Nothing else imports Dask or needs it.

A Dask worker runs no job itself: our worker processes do, so a law or an FMU that crashes or hangs costs one job and
nothing more. When a Dask worker itself is lost, Dask gives its jobs to another.
"""

import contextlib
import gc
import ipaddress
import itertools
import logging
import queue
import socket
import time
import uuid
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import distributed
from distributed.client import FutureCancelledError

from hil.batch.job import LOST, Job, Outcome
from hil.batch.pool import COLLECT_S, Runner, drain
from hil.core.errors import BadInputError, HilError, LinkError
from hil.core.scratch import scratch_folder

BENCH = "bench"
"""The Dask resource of a worker that may use the one hardware bench."""
CONNECT_S = 10.0
_AHEAD = 2
"""Jobs queued per worker besides the running one. Enough to keep it busy; the scheduler loses them if it dies."""
_LEAST_AHEAD = 4
_QUERY_PERIOD_S = 2.0
_PATIENCE_S = 300.0
_GATHER_S = 60.0
Done = tuple[Outcome, bytes | None]
"""An outcome with the bytes of its recording."""


class RunnersOfAWorker(distributed.WorkerPlugin):
    """The worker processes of one Dask worker, one for each of its threads."""

    idempotent = True  # to register it again would end the jobs under way

    def __init__(self, name: str = "") -> None:
        # A name for each pool: Dask would end the processes of another pool that has the same.
        self.name = name or f"mecanum-hil-batch-{uuid.uuid4().hex}"
        self._idle: queue.SimpleQueue[Runner] = queue.SimpleQueue()
        self._all: list[Runner] = []
        self._is_ending = False

    def __reduce__(self) -> tuple[type["RunnersOfAWorker"], tuple[str]]:
        """Pickle the name alone: Dask lets jobs ask for the plugin before its ``setup`` has ended."""
        return RunnersOfAWorker, (self.name,)

    def teardown(self, worker: Any) -> None:
        """End the processes."""
        self._is_ending = True
        for runner in self._all:
            runner.kill()
        for runner in drain(self._idle):
            runner.close()

    def run(self, job: Job, worker: str) -> Done:
        """Do a job. Raises Reschedule when it is lost because this Dask worker ends: another then does it."""
        try:
            runner = self._idle.get_nowait()
        except queue.Empty:
            runner = Runner()
            self._all.append(runner)
        try:
            with scratch_folder("batch") as folder:
                outcome = runner.run(job._replace(recording=str(folder / "run.rrd")))
                recording = None if outcome.recording is None else Path(outcome.recording).read_bytes()
        finally:
            self._idle.put(runner)
        if outcome.status == LOST and self._is_ending:
            raise distributed.Reschedule
        return outcome._replace(worker=worker), recording


def run_on_worker(name: str, job: Job) -> Done | None:
    """Do a job on this Dask worker; None when it has no plugin of this name, as after the scheduler was restarted."""
    worker = distributed.get_worker()
    runners = worker.plugins.get(name)
    if runners is None:
        return None
    assert isinstance(runners, RunnersOfAWorker)
    return runners.run(job, f"{socket.gethostname()} {worker.name}")


class DaskPool:
    """A pool on the cluster at an address; with ``on_bench`` jobs go only to workers with the resource ``bench``.

    The jobs of a lost Dask worker go to another, and are lost when Dask gives them up. When the scheduler is lost, its
    jobs are submitted again once it is back.

    Raises LinkError when no scheduler answers, BadInputError for an address without TLS certificates. ``room`` and
    ``collect`` raise LinkError when the scheduler did not come back within 5 min, or a worker cannot do jobs at all.
    """

    def __init__(self, address: str, *, on_bench: bool = False) -> None:
        self._address = address
        self._runners = RunnersOfAWorker()
        self._resources = {BENCH: 1} if on_bench else None
        self._client: distributed.Client | None = _connect(address)
        self._is_prepared = False
        self._jobs: dict[str, tuple[Job, distributed.Future[Done | None]]] = {}
        self._again: list[Job] = []
        self._finished: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._numbers = itertools.count()
        self._threads = 0
        self._queried_s = -_QUERY_PERIOD_S
        self._gone_s: float | None = None

    @property
    def in_flight(self) -> int:
        return len(self._jobs) + len(self._again)

    def room(self) -> int:
        """Return how many more jobs may be submitted now: none while the scheduler cannot be reached."""
        if not self._is_ready():
            self._reconnect()
            return 0
        self._gone_s = None
        while self._again:
            self.submit(self._again.pop())
        return max(0, max(_LEAST_AHEAD, (1 + _AHEAD) * self._workers()) - len(self._jobs))

    def submit(self, job: Job) -> None:
        assert self._client is not None
        # A unique name: Dask takes two jobs of one name for the same.
        name = f"run-{job.key[:16]}-{next(self._numbers)}"
        future = self._client.submit(
            run_on_worker, self._runners.name, job, key=name, pure=False, resources=self._resources
        )
        self._jobs[name] = (job, future)
        future.add_done_callback(lambda _: self._finished.put(name))

    def collect(self) -> list[Outcome]:
        outcomes = []
        for name in drain(self._finished, COLLECT_S):
            job, future = self._jobs.pop(name)
            done = _result(job, future)
            if done is None:
                self._again.append(job)
                self._is_prepared = False
                continue
            outcome, recording = done
            if recording is not None:
                Path(job.recording).write_bytes(recording)
                outcome = outcome._replace(recording=job.recording)
            outcomes.append(outcome)
        return outcomes

    def trouble(self) -> str | None:
        if not self._is_connected:
            return f"the scheduler {self._address} cannot be reached; waiting for it"
        needed = f" with --resources {BENCH}=1" if self._resources else ""
        return None if self._workers() else f"the scheduler {self._address} has no worker{needed}; waiting for one"

    def close(self) -> None:
        """Drop the jobs that are not done, and end our processes, which the cluster would keep otherwise."""
        if self._client is None:
            return
        with contextlib.suppress(Exception):  # the scheduler may be gone, which no longer matters
            self._client.cancel([future for _, future in self._jobs.values()], force=True)
            if self._is_connected:
                self._client.unregister_worker_plugin(self._runners.name)
        self._client.close(timeout=2.0)

    @property
    def _is_connected(self) -> bool:
        return self._client is not None and self._client.status == "running"

    def _is_ready(self) -> bool:
        """Return whether the scheduler's workers have our plugin; register it where they do not, as after a restart."""
        if self._client is None or not self._is_connected:
            return False
        if not self._is_prepared:
            try:
                self._client.register_plugin(self._runners)
                self._is_prepared = True
            except (ImportError, AttributeError) as error:
                raise LinkError(
                    f"the scheduler and the workers of Dask need this package, and one has another or none ({error}); "
                    "install the same there"
                ) from error
            except OSError:
                pass  # the scheduler has just gone
        return self._is_prepared

    def _reconnect(self) -> None:
        """Try to connect again. The client itself tries for a while, and then closes."""
        self._gone_s = self._gone_s or time.monotonic()
        if time.monotonic() - self._gone_s > _PATIENCE_S:
            raise LinkError(
                f"--scheduler {self._address}: it has gone, and did not come back within {_PATIENCE_S:g} s; "
                "give the same command again when it is there, and the campaign goes on"
            )
        if self._client is None or self._client.status == "closed":
            self._client = None
            with contextlib.suppress(LinkError):
                self._client = _connect(self._address)
                self._is_prepared = False

    def _workers(self) -> int:
        """Return the threads of the workers that can do the jobs, at most two seconds old."""
        now_s = time.monotonic()
        if self._client is None or now_s - self._queried_s < _QUERY_PERIOD_S:
            return self._threads
        self._queried_s = now_s
        with contextlib.suppress(OSError):  # the scheduler has just gone
            workers = self._client.scheduler_info(n_workers=-1)["workers"].values()
            able = (one for one in workers if self._resources is None or BENCH in one.get("resources", {}))
            self._threads = sum(worker["nthreads"] for worker in able)
        return self._threads


def _result(job: Job, future: "distributed.Future[Done | None]") -> Done | None:
    """Return a job's outcome and recording, or None when the job has to be submitted again.

    Raises LinkError when the Dask worker could not do it, because it would fail again.
    """
    if future.status in ("cancelled", "lost"):
        return None
    is_error = future.status == "error"
    try:
        return future.result(timeout=_GATHER_S)
    except distributed.KilledWorker as error:
        reason = f"every worker of Dask that had it was lost, {error.allowed_failures + 1} of them"
        return Outcome(job.key, LOST, reason), None
    except FutureCancelledError:
        return None
    except (TimeoutError, OSError) as error:
        if is_error:  # an error of the job itself, not of the connection
            raise LinkError(
                f"a worker of Dask cannot do runs: {error}; make room for temporary files there, or make their folder "
                "writable, and give the same command again"
            ) from error
        return None


def _connect(address: str) -> "distributed.Client":
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # our own messages say what matters
    try:
        return distributed.Client(address, timeout=CONNECT_S, set_as_default=False, name="mecanum-hil")
    except TypeError:  # this is how Dask reports missing certificates
        failure: HilError = BadInputError(
            f"--scheduler {address}: TLS needs certificates; name them in DASK_DISTRIBUTED__COMM__TLS__CA_FILE, "
            "..._TLS__CLIENT__CERT and ..._TLS__CLIENT__KEY, as CAMPAIGNS.md shows"
        )
    except (OSError, TimeoutError, ValueError) as error:
        failure = LinkError(
            f"--scheduler {address}: no scheduler of Dask answers there ({error}); start one with: dask scheduler"
        )
    # The failed Client is in a reference cycle. If the collector ran its __del__ in the thread of the next Client's
    # event loop, the two would deadlock: __del__ needs the lock that the start of the loop holds.
    gc.collect()
    raise failure


def check_address(address: str) -> None:
    """Raise BadInputError unless the text is the address of a scheduler that may be used.

    Whoever reaches a scheduler can run programs on its workers, so without TLS it must be on this machine.
    """
    parts = urlsplit(address)
    host = port = None
    with contextlib.suppress(ValueError):
        host, port = parts.hostname, parts.port
    if parts.scheme not in ("tls", "tcp") or not host or not port:
        raise BadInputError(f"--scheduler {address}: expected tls://HOST:PORT, or tcp://127.0.0.1:PORT on this machine")
    is_loopback = host == "localhost"
    with contextlib.suppress(ValueError):
        is_loopback = is_loopback or ipaddress.ip_address(host).is_loopback
    if parts.scheme == "tcp" and not is_loopback:
        raise BadInputError(
            f"--scheduler {address}: over tcp anybody on the way could run programs on the workers; use "
            f"tls://{host}:{port}, with certificates as in CAMPAIGNS.md"
        )
