"""Single bits of a recording are inverted: each is told, and no value, event or property is read that was not recorded.

The undamaged file, as it was read before, is what is compared with.
"""

import struct
import subprocess
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.addons.report.viewer import viewer_executable
from hil.core.signals import pack_row
from hil.judge.recorded import judged_run
from hil.judge.run_json import to_json
from hil.record.contents import DamagedError
from hil.record.decode import decode
from hil.record.decode_rrd import decode_rrd
from hil.record.reader import read
from hil.record.recording import Recording
from tests.support.examples import chance, examples
from tests.support.recorded_circle import circle_table

ROWS = 2500
SUMMARY = {"passed": True, "lost_rows": 0, "allow": [], "reasons": {}}


def recorded(path: Path) -> Path:
    with Recording(path, properties={"scenario_name": "made_up", "law": "none"}, blocking=True) as recorder:
        recorder.event(-0.02, "info", "ARMED")
        for row in circle_table(ROWS):
            recorder.put(pack_row(tuple(row)))
        recorder.event(0.4, "warning", "STOPPING: host request")
        assert recorder.finish(SUMMARY).complete
    return path


def cut(path: Path) -> Path:
    """The file of a recorder that was killed."""
    whole = recorded(path).read_bytes()
    path.write_bytes(whole[: len(whole) * 6 // 10])
    return path


def optimized(path: Path) -> Path:
    """The file as rerun's own tool writes it again."""
    source = recorded(path.with_name("source.rrd"))
    subprocess.run([viewer_executable(), "rrd", "optimize", source, "-o", path], check=True, capture_output=True)
    return path


def last_property(path: Path) -> range:
    """Return the bytes of the message that holds the check value of all bytes before it; none in an .mcap file."""
    if path.suffix != ".rrd":
        return range(0)
    recorder = decode_rrd(path, None).properties.end
    if "bytes" not in recorder:
        return range(0)
    begin = int(recorder["bytes"])
    _, length = struct.unpack_from("<QQ", path.read_bytes(), begin)
    return range(begin, begin + 16 + length)


@contextmanager
def decoding() -> Iterator[Callable[[Path], tuple[dict[str, Any], dict[str, Any]]]]:
    """Yield ``decode``, done in another process, which rerun's reader aborts on some damage: that is a DamagedError."""
    pools: list[ProcessPoolExecutor] = []

    def apart(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
        if not pools:
            pools.append(ProcessPoolExecutor(1, mp_context=get_context("spawn")))
        try:
            return pools[0].submit(decode, path).result()
        except BrokenProcessPool:
            pools.pop().shutdown()
            raise DamagedError("rerun's reader ended its process") from None

    try:
        yield apart
    finally:
        for pool in pools:
            pool.shutdown()


@pytest.mark.parametrize(
    ("kind", "make", "every"),
    [
        ("rrd", recorded, True),
        ("mcap", recorded, True),
        ("rrd", cut, False),
        ("mcap", cut, False),
        ("rrd", optimized, False),
    ],
)
def test_no_flipped_bit_goes_unnoticed(kind: str, make: Callable[[Path], Path], every: bool, tmp_path: Path) -> None:
    """``every``: the bytes that only viewers read are covered too, but for those around the last check value."""
    path = make(tmp_path / f"run.{kind}")
    last = last_property(path) if every else range(0)
    whole, (told, signals) = path.read_bytes(), decode(path)
    noticed = 0
    with decoding() as apart:
        for bit in chance().choices(range(8 * len(whole)), k=examples(0.4)):
            content = bytearray(whole)
            content[bit // 8] ^= 1 << bit % 8
            path.write_bytes(content)
            try:
                found, left = apart(path)
            except DamagedError:
                noticed += 1
                continue
            noticed += found["notes"] != told["notes"]
            assert not every or found["notes"] != told["notes"] or bit // 8 in last, bit
            same = {name: told[name] == found[name] for name in ("events", "properties", "summary", "rows")}
            assert all(same.values()) or found["notes"] != told["notes"], (bit, same)
            if not same["rows"]:
                # Nothing tells how many rows the end of a file has that was cut off.
                assert not every or found["rows_missing"] == ROWS - found["rows"] or found["rows_dropped"] is None, bit
            places = np.searchsorted(signals["loop.tick"], left["loop.tick"])
            assert all(left[name].tobytes() == signals[name][places].tobytes() for name in signals), bit
            assert all(event in told["events"] for event in found["events"]), bit
            assert found["summary"] in (told["summary"], None), bit
    assert noticed or not every


@pytest.mark.parametrize("kind", ["rrd", "mcap"])
def test_a_run_whose_recording_lost_rows_by_damage_has_not_passed(kind: str, tmp_path: Path) -> None:
    path = recorded(tmp_path / f"run.{kind}")
    assert to_json(judged_run(read(path)))["passed"]
    whole = path.read_bytes()
    for place in range(len(whole) // 5, len(whole), len(whole) // 50):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 4]) + whole[place + 1 :])
        if 0 < decode(path)[0]["rows"] < ROWS:
            break
    found = to_json(judged_run(read(path)))
    assert found["lost_rows"] > 0
    assert not found["passed"]
    assert found["damaged"]


def test_a_recording_of_a_version_without_check_values_is_read_with_a_note() -> None:
    run = read(Path(__file__).parents[1] / "recordings" / "circle_speed_ca92b7a.rrd")
    assert len(run.signals["loop.tick"]) > 0
    assert not run.is_damaged
    old = "a version without check values recorded it: damage that changes its values cannot be noticed"
    assert run.notes == (f"circle_speed_ca92b7a.rrd: {old}",)
