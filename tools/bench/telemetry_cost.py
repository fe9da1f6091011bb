"""What telemetry costs: ``python tools/bench/telemetry_cost.py``; exit code 1 when a figure is over its limit.

First a loop at 1 kHz with 40 signals a tick, in turns: without telemetry, with a recording, with a recording and a
viewer that shows it, with a recording and a viewer that is frozen; then once with one ``rr.log`` a signal. Then a
recording of 20 minutes at 1 kHz, with every signal of a run, is made in lockstep and reviewed.

The rows are those of a real run of ``paper_circle``, again and again, with the clock going on, and each is made anew in
its tick, as a run makes it; the recording has the properties of that run, so that all is drawn that ``hil run
--record`` draws, and the loop has the real-time settings of a run. Lateness counts as changed when every turn
with telemetry has a greater p99 than every turn without: by chance that happens once in 252 times with 5 rounds.
"""

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

import hil
from hil.addons.report.viewer import free_port, live_address, viewer_executable
from hil.core.errors import BadInputError
from hil.core.signals import SIGNAL_NAMES, pack_row
from hil.core.types import WHEEL_NAMES
from hil.record.contents import DamagedError
from hil.record.decode import decode
from hil.record.recording import Recording
from hil.runtime.provenance import properties
from hil.runtime.realtime import RealTime, real_time
from hil.scenario import load
from hil.scenario.tables import RealtimeTable

PERIOD_NS = 1_000_000
SCENARIO = "paper_circle"
REAL_ROWS = 5000
WARM_UP = 1000
_DRAWN = (
    *("loop.t_s", "loop.tick", "loop.lateness_us", "loop.tick_us", "robot.state"),
    *(f"{pose}.{name}" for pose in ("reference", "pose", "truth") for name in ("x_m", "y_m", "heading_rad")),
    *("error.x_m", "error.y_m", "error.planar_m", "error.heading_rad"),
    *(
        f"wheel.{wheel}.{name}"
        for name in ("speed_rad_s", "speed_command_rad_s", "torque_command_n_m", "current_a")
        for wheel in WHEEL_NAMES
    ),
)
FORTY = (*_DRAWN, *[name for name in SIGNAL_NAMES if name not in _DRAWN][: 40 - len(_DRAWN)])
Row = tuple[float, ...]
Put = Callable[[Row], object]


class Turn(NamedTuple):
    """Medians and 99th percentile of one turn [µs], and its bytes a scalar in the file; None where there is no file."""

    work_us: float
    late_p50_us: float
    late_p99_us: float
    size: float | None


class Figure(NamedTuple):
    """A figure with its limit."""

    name: str
    value: float
    limit: float
    unit: str

    def tell(self) -> bool:
        """Print it; return whether it is within its limit."""
        is_within = self.value <= self.limit
        word = "ok" if is_within else "OVER"
        share = f"{self.value / self.limit:.2f} of the limit, {self.limit:g} {self.unit}"
        print(f"{word:<5}{self.name}: {self.value:.3g} {self.unit} ({share})")
        return is_within


def main() -> int:
    """Measure, print, and judge."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=5.0, help="length of each of the turns in real time")
    parser.add_argument("--rounds", type=int, default=5, help="turns of each kind")
    parser.add_argument("--minutes", type=float, default=20.0, help="length of the recording that is reviewed")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
    options = parser.parse_args()
    print(f"{os.cpu_count()} cores, load of the last minute: {_load()}")
    scenario = load(SCENARIO, mode="lockstep", link="memory:")
    told = properties(scenario)
    result = hil.run(SCENARIO, mode="lockstep", link="memory:", set={"loop.duration_s": REAL_ROWS / 1000, "expect": []})
    with tempfile.TemporaryDirectory() as folder:
        bench = _Bench(Path(folder), told, result.signals)
        figures = bench.in_real_time(round(options.seconds * 1000), options.rounds)
        figures += bench.review(round(options.minutes * 60_000))
    print(f"load of the last minute: {_load()}")
    within = [figure.tell() for figure in figures]
    if options.json is not None:
        figures_of = {figure.name: {"value": figure.value, "limit": figure.limit} for figure in figures}
        options.json.write_text(json.dumps(figures_of, indent=2) + "\n", encoding="utf-8")
    return 0 if all(within) else 1


class _Bench:
    """The measurement: recordings into a folder, of rows from a run."""

    def __init__(self, folder: Path, told: dict[str, str], signals: object) -> None:
        self._folder = folder
        self._told = told
        self._signals: dict[str, np.ndarray] = dict(signals)  # type: ignore[call-overload]

    def in_real_time(self, ticks: int, rounds: int) -> list[Figure]:
        """Run the loops; return the figures of a tick."""
        rows = list(self._rows(FORTY, WARM_UP + ticks))
        kinds: dict[str, Callable[[], Turn]] = {
            "nothing": lambda: _turn(rows, lambda _row: None),
            "recording": lambda: self._recorded(rows, None),
            "viewer": lambda: self._recorded(rows, "shows"),
            "frozen viewer": lambda: self._recorded(rows, "frozen"),
        }
        turns: dict[str, list[Turn]] = {kind: [] for kind in kinds}
        with real_time(RealtimeTable()) as settings:
            _granted(settings)
            for _ in range(rounds):
                for kind, take in kinds.items():
                    turns[kind].append(take())
            turns["rr.log"] = [self._naive(rows[: WARM_UP + ticks // 5])]
        print(
            f"{'1 kHz, 40 signals':<16}{'tick µs':>9}{'late p50':>10}{'late p99 µs of each turn':>40}{'B/scalar':>10}"
        )
        for kind, some in turns.items():
            p99 = " ".join(f"{turn.late_p99_us:.0f}" for turn in sorted(some, key=lambda turn: turn.late_p99_us))
            size = "" if some[0].size is None else f"{statistics.median(_sizes(some)):.1f}"
            print(f"{kind:<16}{_median(some, 0):>9.2f}{_median(some, 1):>10.1f}{p99:>40}{size:>10}")
        # Of the turn of each that the machine's other work disturbed least.
        work_us = {kind: min(turn.work_us for turn in some) for kind, some in turns.items()}
        added_us, naive_us = (work_us[kind] - work_us["nothing"] for kind in ("recording", "rr.log"))
        print(f"added to a tick: {added_us / naive_us:.4f} of what rr.log for each signal adds")
        calm = [turn.late_p99_us for turn in turns["nothing"]]
        lateness = []
        for kind in list(kinds)[1:]:
            late = [turn.late_p99_us for turn in turns[kind]]
            ratio = statistics.median(late) / statistics.median(calm)
            beyond = sum(p99 > max(calm) for p99 in late) / len(late)
            name = f"lateness p99, {kind}: {ratio:.2f} of nothing's; later than every turn without"
            lateness.append(Figure(name, beyond, 0.99, "of the turns"))
        return [
            Figure("added to a tick", added_us, 5.0, "µs"),
            Figure("added to a tick, of rr.log's", added_us / naive_us, 0.05, "of it"),
            *lateness,
            Figure("on disk, 40 signals", statistics.median(_sizes(turns["recording"])), 15.0, "B a scalar"),
        ]

    def review(self, ticks: int) -> list[Figure]:
        """Record so many ticks of every signal and review them; return the figures."""
        path, names = self._folder / "long.rrd", tuple(self._signals)
        with Recording(path, properties=self._told, blocking=True, signals=names, existing="replace") as recording:
            for row in self._rows(names, ticks):
                recording.put(pack_row(row))
            report = recording.finish({})
        if not report.complete:
            raise RuntimeError(f"the recording is not complete: {report.error}")
        size = path.stat().st_size
        begin = time.perf_counter()
        command = [sys.executable, "-c", _REVIEW, str(path)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        seconds = time.perf_counter() - begin
        found, megabytes = (float(word) for word in done.stdout.split())
        if found != ticks:
            raise RuntimeError(f"the review has {found:g} ticks of {ticks}")
        print(f"review of {ticks / 60_000:g} min at 1 kHz, {len(names)} signals, {size / 1e6:.0f} MB")
        return [
            Figure("review", seconds, 10.0, "s"),
            Figure("review, memory of its processes", megabytes, 1000.0, "MB"),
            Figure(f"on disk, {len(names)} signals", size / (ticks * len(names)), 15.0, "B a scalar"),
        ]

    def _recorded(self, rows: Sequence[Row], viewer: str | None) -> Turn:
        path = self._folder / "turn.rrd"
        port = None if viewer is None else free_port()
        with Recording(
            path, properties=self._told, blocking=False, signals=FORTY, live_port=port, existing="replace"
        ) as recording:
            if port is None:
                turn = _turn(rows, lambda row: recording.put(pack_row(row)))
            else:
                for row in rows[:WARM_UP]:
                    recording.put(pack_row(row))
                with _viewer(port, self._folder / "received.rrd", freeze=viewer == "frozen"):
                    turn = _turn(rows, lambda row: recording.put(pack_row(row)), begin=WARM_UP)
            report = recording.finish({})
        if not report.complete:
            raise RuntimeError(f"the recording is not complete: {report.error}")
        return turn._replace(size=path.stat().st_size / (len(rows) * len(FORTY)))

    def _naive(self, rows: Sequence[Row]) -> Turn:
        """Log each signal by itself, in the loop."""
        import rerun as rr

        path = self._folder / "naive.rrd"
        stream = rr.RecordingStream("naive")
        stream.set_sinks(rr.FileSink(path))
        paths = [name.replace(".", "/") for name in FORTY]
        tick = FORTY.index("loop.tick")

        def put(row: Row) -> None:
            stream.set_time("tick", sequence=int(row[tick]))
            for entity, value in zip(paths, row, strict=True):
                stream.log(entity, rr.Scalars(value))

        turn = _turn(rows, put)
        stream.flush()
        stream.disconnect()
        return turn._replace(size=path.stat().st_size / (len(rows) * len(FORTY)))

    def _rows(self, names: Sequence[str], ticks: int) -> Iterator[Row]:
        """Yield the rows of the run again and again; the clock goes on."""
        rows = np.column_stack([self._signals[name] for name in names]).tolist()
        t_column, tick_column = names.index("loop.t_s"), names.index("loop.tick")
        for tick in range(ticks):
            row = rows[tick % len(rows)]
            row[t_column], row[tick_column] = tick / 1000, float(tick)
            yield tuple(row)


_REVIEW = """
import resource, sys
from pathlib import Path
from hil.judge.recorded import review
ticks = review(Path(sys.argv[1]))["ticks"]
peaks = [resource.getrusage(who).ru_maxrss / 1e3 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
print(ticks, sum(peaks))
"""


def _turn(rows: Sequence[Row], put: Put, begin: int = 0) -> Turn:
    """Run the loop; what is before ``WARM_UP`` does not count."""
    now = time.perf_counter_ns
    work_us, late_us = [], []
    due = now() + 10 * PERIOD_NS
    for row in rows[begin:]:
        time.sleep(max(0, due - now()) / 1e9)
        late_us.append((now() - due) / 1e3)
        fresh = tuple([value * 1.0 for value in row])  # a run's values come from the tick itself
        start = now()
        put(fresh)
        work_us.append((now() - start) / 1e3)
        due += PERIOD_NS
    counted = WARM_UP - begin
    p50, p99 = np.percentile(late_us[counted:], [50, 99])
    return Turn(statistics.median(work_us[counted:]), float(p50), float(p99), None)


@contextmanager
def _viewer(port: int, path: Path, *, freeze: bool) -> Iterator[None]:
    """Have a real viewer without a window receive the run; with ``freeze`` it stops when it has begun to."""
    path.unlink(missing_ok=True)
    command = [str(viewer_executable()), "--bind", "127.0.0.1", "--port", str(free_port()), "--save", str(path)]
    quiet = {**os.environ, "RUST_LOG": "off"}
    with subprocess.Popen([*command, live_address(port)], env=quiet) as viewer:
        try:
            deadline = time.monotonic() + 60.0
            while not _received(path):
                if time.monotonic() > deadline:
                    raise RuntimeError("the viewer received nothing for 60 s")
                time.sleep(0.1)
            if freeze:
                os.kill(viewer.pid, signal.SIGSTOP)
            yield
        finally:
            viewer.kill()


def _received(path: Path) -> bool:
    try:
        return bool(decode(path)[0]["rows"])
    except (DamagedError, BadInputError):
        return False


def _granted(settings: RealTime) -> None:
    """Say which of the settings of a run in real time this machine refuses."""
    for sentence in settings.figures()["refused"].values():
        print(f"unlike a run with every right: {sentence}")


def _median(turns: Sequence[Turn], field: int) -> float:
    return float(statistics.median(turn[field] or 0.0 for turn in turns))


def _sizes(turns: Sequence[Turn]) -> list[float]:
    return [turn.size for turn in turns if turn.size is not None]


def _load() -> str:
    return f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"


if __name__ == "__main__":
    sys.exit(main())
