"""Where the runs of a campaign are done: workers of Dask, each with processes of ours that do the runs.

A worker of Dask runs nothing itself: a law or an FMU that crashes or hangs ends one of our processes, and the run is a
row with its last words. What a worker of Dask does not survive came from outside, and Dask gives the run to another.
"""

import contextlib
import ipaddress
import logging
import queue
import socket
import tempfile
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from hil.batch.campaign.jobs import WORK, Job
from hil.batch.campaign.rows import LOST, Said
from hil.batch.pool import Performer
from hil.core.errors import BadInputError, LinkError

try:
    import distributed
except ImportError as error:
    raise BadInputError(
        "hil campaign needs Dask, which is not installed; install it with: pip install 'mecanum-hil[campaign]'"
    ) from error

BENCH = "bench"
"""The resource of Dask's that a worker has which may use the one hardware bench."""
_CONNECT_S = 10.0


class Answer(NamedTuple):
    """What came of a run: what its process says, where that was, and the bytes of its recording."""

    said: Said
    worker: str
    recording: bytes | None


class RunProcesses(distributed.WorkerPlugin):
    """The processes of a Dask worker that do runs, one for each of its threads."""

    idempotent = True  # to register it again would end the runs in hand

    def __init__(self, limit_s: float, name: str = "") -> None:
        self._limit_s = limit_s
        # A name for each campaign: Dask would end the processes of another campaign that has the same.
        self.name = name or f"mecanum-hil-campaign-{uuid.uuid4().hex}"
        self._idle: queue.SimpleQueue[Performer[Job, Said]] = queue.SimpleQueue()
        self._all: list[Performer[Job, Said]] = []
        self._is_ending = False

    def __reduce__(self) -> tuple[type["RunProcesses"], tuple[float, str]]:
        """Go to a worker as what it is made of: Dask has runs ask for it before ``setup`` would be done."""
        return RunProcesses, (self._limit_s, self.name)

    def teardown(self, worker: Any) -> None:
        """End the processes."""
        self._is_ending = True
        for performer in self._all:
            performer.kill()
        with contextlib.suppress(queue.Empty):
            while True:
                self._idle.get_nowait().close()

    def perform(self, job: Job, worker: str) -> Answer:
        """Do a run, once more when its process ends by itself: that may have been somebody else's doing.

        Raises Reschedule, by which Dask gives the run to another worker, when it ended because this worker does.
        """
        with self._performer() as performer, tempfile.TemporaryDirectory(prefix="hil_campaign_") as folder:
            job = job._replace(recording=str(Path(folder, "run.rrd")))
            said = performer.perform(job)
            if said.outcome == LOST and "crashed" in str(said.reason) and not self._is_ending:
                said = performer.perform(job)
                if said.outcome == LOST:
                    said = said._replace(reason=f"its process ended twice, at last: {said.reason}")
            if said.outcome == LOST and self._is_ending:
                raise distributed.Reschedule
            recording = Path(said.recording).read_bytes() if said.recording is not None else None
            return Answer(said, worker, recording)

    @contextlib.contextmanager
    def _performer(self) -> Iterator[Performer[Job, Said]]:
        try:
            performer = self._idle.get_nowait()
        except queue.Empty:
            performer = Performer(WORK, self._limit_s)
            self._all.append(performer)
        try:
            yield performer
        finally:
            self._idle.put(performer)


def perform_on_worker(name: str, job: Job) -> Answer | None:
    """Do a run on the worker of Dask that this is called on; None where ``RunProcesses`` of this name are not, as
    after another scheduler has come."""
    worker = distributed.get_worker()
    processes = worker.plugins.get(name)
    if processes is None:
        return None
    assert isinstance(processes, RunProcesses)
    return processes.perform(job, f"{socket.gethostname()} {worker.name}")


class Place(NamedTuple):
    """Where runs are done: an existing scheduler by its address, or None for workers of our own, and how many."""

    scheduler: str | None
    workers: int
    limit_s: float


@contextlib.contextmanager
def cluster(place: Place) -> Iterator[str | Any]:
    """Give what a client connects to: the address of the scheduler, or a cluster of our own with as many workers.

    Its dashboards are on 127.0.0.1.
    """
    if place.scheduler is not None:
        check_address(place.scheduler)
        yield place.scheduler
        return
    with distributed.LocalCluster(
        n_workers=place.workers,
        threads_per_worker=1,
        processes=False,
        resources={BENCH: 1} if place.workers == 1 else None,
        dashboard_address="127.0.0.1:0",
        worker_dashboard_address="127.0.0.1:0",  # None would have it listen on all interfaces
        memory_limit=None,
        silence_logs=50,
    ) as own:
        yield own


def connect(to: Any) -> "distributed.Client":
    """Return a client. Raises LinkError when no scheduler answers, BadInputError without certificates for TLS."""
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # what matters of it is said in our words
    try:
        return distributed.Client(to, timeout=_CONNECT_S, set_as_default=False, name="mecanum-hil")
    except TypeError as error:  # as Dask has it
        raise BadInputError(
            f"--scheduler {to}: TLS needs certificates; name them in DASK_DISTRIBUTED__COMM__TLS__CA_FILE, "
            "..._TLS__CLIENT__CERT and ..._TLS__CLIENT__KEY, as CAMPAIGNS.md shows"
        ) from error
    except (OSError, TimeoutError, ValueError) as error:
        raise LinkError(
            f"--scheduler {to}: no scheduler of Dask answers there ({error}); start one with: dask scheduler"
        ) from error


def prepare(client: "distributed.Client", processes: RunProcesses) -> None:
    """Give its workers, also those that come later, our processes. Raises OSError when the scheduler goes,
    LinkError when it or a worker lacks this package."""
    try:
        client.register_plugin(processes)
    except (ImportError, AttributeError) as error:
        raise LinkError(
            f"the scheduler and the workers of Dask need this package, and one has another or none ({error}); install "
            "the same there"
        ) from error


def check_address(address: str) -> None:
    """Raise BadInputError for what is no address of a scheduler that may be used: any program may ask for work there
    unless TLS keeps others out, so without it only this machine's own will do."""
    parts = urlsplit(address)
    try:
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if parts.scheme not in ("tls", "tcp") or not host or not port:
        raise BadInputError(f"--scheduler {address}: expected tls://HOST:PORT, or tcp://127.0.0.1:PORT on this machine")
    if parts.scheme == "tcp" and not _is_loopback(host):
        raise BadInputError(
            f"--scheduler {address}: over tcp anybody on the way could run programs on the workers; use "
            f"tls://{host}:{port}, with certificates as in CAMPAIGNS.md"
        )


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
