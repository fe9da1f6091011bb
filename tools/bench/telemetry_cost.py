"""What telemetry costs, against logging each signal by itself: ``python tools/bench/telemetry_cost.py``.

A loop at 1 kHz with 40 signals a tick runs in turns without telemetry and with a recording, and then with one
``rr.log`` a signal.
Then a recording of 20 minutes at 1 kHz with every signal of a run is made in lockstep and reviewed.
"""

import argparse
import json
import math
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hil.signals import SIGNAL_NAMES
from hil.telemetry import Recording

PERIOD_NS = 1_000_000
ROUNDS = 4
_DRAWN = (
    *("loop.t_s", "loop.tick", "robot.state"),
    *(f"{pose}.{name}" for pose in ("reference", "pose", "truth") for name in ("x_m", "y_m", "heading_rad")),
)
FORTY = (*_DRAWN, *[name for name in SIGNAL_NAMES if name not in _DRAWN][: 40 - len(_DRAWN)])
Put = Callable[[tuple[float, ...]], object]


class Turn(NamedTuple):
    """What each tick took, and how late it was [µs]."""

    work_us: list[float]
    lateness_us: list[float]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=5.0, help="length of each of the turns in real time")
    parser.add_argument("--minutes", type=float, default=20.0, help="length of the recording that is reviewed")
    options = parser.parse_args()
    ticks = round(options.seconds * 1000)
    with tempfile.TemporaryDirectory() as folder:
        _in_real_time(Path(folder), ticks)
        _review(Path(folder) / "long.rrd", round(options.minutes * 60_000))


def _in_real_time(folder: Path, ticks: int) -> None:
    _become_real_time()
    rows = list(_rows(FORTY, ticks))
    nothing, recorded, naive = (Turn([], []) for _ in range(3))
    sizes = []
    for turn in range(ROUNDS):
        path = folder / f"{turn}.rrd"
        _turn(rows, lambda _row: None, nothing)
        with Recording(path, properties={}, blocking=False, signals=FORTY) as recording:
            _turn(rows, recording.put, recorded)
            assert recording.finish({}).complete
        sizes.append(path.stat().st_size / (ticks * len(FORTY)))
    naive_path = folder / "naive.rrd"
    _turn(rows, _naive(naive_path), naive)
    naive_size = naive_path.stat().st_size / (ticks * len(FORTY))
    print(f"{'1 kHz, 40 signals':<30}{'p50 µs':>10}{'p99 µs':>10}   {'lateness p50, p99 µs':<24}{'B a scalar':>10}")
    size = sum(sizes) / len(sizes)
    turns = {"nothing": (nothing, math.nan), "recording": (recorded, size), "rr.log": (naive, naive_size)}
    for name, (turn_, bytes_) in turns.items():
        work, late = (np.percentile(series, [50, 99]) for series in turn_)
        print(f"{name:<30}{work[0]:>10.2f}{work[1]:>10.2f}   {late[0]:>10.1f},{late[1]:>11.1f}  {bytes_:>10.1f}")
    added = float(np.median(recorded.work_us) - np.median(nothing.work_us))
    print(f"added to a tick: {added:.2f} µs (limit 5); {size:.1f} B a scalar (limit 15)")


def _turn(rows: list[tuple[float, ...]], put: Put, into: Turn) -> None:
    now = time.perf_counter_ns
    due = now() + 10 * PERIOD_NS
    for row in rows:
        time.sleep(max(0, due - now()) / 1e9)
        begin = now()
        put(row)
        into.work_us.append((now() - begin) / 1e3)
        into.lateness_us.append((begin - due) / 1e3)
        due += PERIOD_NS


def _naive(path: Path) -> Put:
    """Return what logs each signal by itself, in the loop."""
    import rerun as rr

    stream = rr.RecordingStream("naive")
    stream.set_sinks(rr.FileSink(path))
    paths = [name.replace(".", "/") for name in FORTY]
    tick = FORTY.index("loop.tick")

    def put(row: tuple[float, ...]) -> None:
        stream.set_time("tick", sequence=int(row[tick]))
        for entity, value in zip(paths, row, strict=True):
            stream.log(entity, rr.Scalars(value))

    return put


_REVIEW = """
import json, resource, sys, time
from pathlib import Path
from hil.review import review
begin = time.perf_counter()
ticks = review(Path(sys.argv[1]))["ticks"]
peaks = [resource.getrusage(who).ru_maxrss / 1e3 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
print(json.dumps([ticks, time.perf_counter() - begin, sum(peaks)]))
"""


def _review(path: Path, ticks: int) -> None:
    with Recording(path, properties={}, blocking=True) as recording:
        for row in _rows(SIGNAL_NAMES, ticks):
            recording.put(row)
        assert recording.finish({}).complete
    done = subprocess.run([sys.executable, "-c", _REVIEW, str(path)], capture_output=True, text=True, check=True)
    found, seconds, megabytes = json.loads(done.stdout)
    assert found == ticks
    size = path.stat().st_size / (ticks * len(SIGNAL_NAMES))
    print(
        f"review of {ticks / 60_000:g} min at 1 kHz, {len(SIGNAL_NAMES)} signals, {path.stat().st_size / 1e6:.0f} MB "
        f"({size:.1f} B a scalar): {seconds:.1f} s (limit 10), {megabytes:.0f} MB in both processes (limit 1000)"
    )


def _rows(signals: tuple[str, ...], ticks: int) -> Iterator[tuple[float, ...]]:
    """Yield rows with noise in all their bits, the worst for a file; the clock is right."""
    chance = random.Random(1)
    noise = [[chance.gauss(0.0, 1.0) for _ in signals] for _ in range(997)]
    t_column, tick_column, state = (signals.index(name) for name in ("loop.t_s", "loop.tick", "robot.state"))
    for tick in range(ticks):
        row = noise[tick % 997]
        row[t_column], row[tick_column], row[state] = tick / 1000, float(tick), 3.0
        yield tuple(row)


def _become_real_time() -> None:
    if sys.platform == "linux":
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))
        except PermissionError:
            print("without real-time priority, which takes root: lateness says little")


if __name__ == "__main__":
    main()
