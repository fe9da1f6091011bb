"""Live viewing: served on this machine only, thinned, and never at the cost of the run."""

import os
import signal
import socket
import subprocess
import sys
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
import rerun.chunk as rrc

from hil.addons.report.live_server import BATCH_S, LIVE_PERIOD_S, MEMORY_LIMIT
from hil.addons.report.run_drawing import RunDrawing
from hil.addons.report.viewer import (
    NOTHING_ELSEWHERE,
    free_port,
    has_display,
    live_address,
    show_live,
    view,
    viewer_executable,
)
from hil.core.errors import BadInputError
from hil.core.signals import INDEX, SIGNAL_NAMES, pack_row
from hil.record.decode import decode
from hil.record.properties import SUMMARY_PROPERTY
from hil.record.recording import Recording
from hil.record.stream import Stream
from hil.record.viewing import live_hint
from hil.runtime.provenance import properties
from hil.scenario import load
from tests.addons.report.test_telemetry_drawings import read as drawn
from tests.support.processes import is_running, wait_for
from tests.support.recorded_circle import PERIOD_S, circle_rows, circle_table

linux_only = pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
_LISTENING = "0A"


def listening_addresses(port: int) -> set[str]:
    """IPv4 and IPv6 addresses, as the kernel writes them, that listen on a port."""
    found = set()
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in Path(table).read_text().splitlines()[1:]:
            fields = line.split()
            address, hexadecimal = fields[1].split(":")
            if fields[3] == _LISTENING and int(hexadecimal, 16) == port:
                found.add(address)
    return found


LOOPBACK = {"0100007F"}


@linux_only
def test_a_run_is_served_thinned_on_the_loopback_interface_alone(tmp_path: Path) -> None:
    port, received = free_port(), tmp_path / "received.rrd"
    with Recording(None, properties={}, blocking=True, live_port=port) as recording:
        for row in circle_rows(2000):
            recording.put(pack_row(row))
        report = recording.finish({"passed": True}, keep_live=True)
        assert (report.rows_put, report.rows_lost, report.error) == (2000, 0, None)
        assert listening_addresses(port) == LOOPBACK
        with receiving(port, received):
            wait_for(lambda: len(received_s(received)) == 100)
            wait_for(lambda: holds_summary(received))
    np.testing.assert_allclose(np.diff(received_s(received)), 0.02, atol=1e-9)
    assert listening_addresses(port) == set()


@linux_only
def test_a_viewer_that_is_absent_frozen_killed_and_restarted_costs_no_row(tmp_path: Path) -> None:
    """The second viewer sees the run again from its beginning, with what came while the first one was frozen."""
    port, path = free_port(), tmp_path / "run.rrd"
    rows = list(circle_rows(9000))
    with Recording(path, properties={}, blocking=False, live_port=port) as recording:

        def put(begin: int, end: int) -> None:
            for row in rows[begin:end]:
                recording.put(pack_row(row))
            wait_for(lambda: recording.ring.saved == end)

        put(0, 3000)
        with receiving(port, tmp_path / "first.rrd") as (first, received):
            wait_for(lambda: received() >= 150)
            os.kill(first.pid, signal.SIGSTOP)
            put(3000, 6000)
            first.kill()
        put(6000, 9000)
        report = recording.finish({"passed": True}, keep_live=True)
        with receiving(port, tmp_path / "second.rrd") as (_, received):
            wait_for(lambda: received() == 450)
    assert report.complete
    assert report.rows_written == 9000
    _, signals = decode(path)
    assert signals["loop.tick"].tobytes() == np.arange(9000.0).tobytes()


def received_s(path: Path) -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
    """The times of the rows in a file that a viewer is still writing."""
    try:
        return np.unique(drawn(path, "/loop/clock", "Scalars:scalars", 2)[0])
    except (RuntimeError, OSError, ValueError):
        return np.empty(0)


def holds_summary(path: Path) -> bool:
    try:
        properties = list(rrc.RrdReader(path).stream().filter(content="/__properties/**"))
    except RuntimeError:  # the viewer is writing its next message
        return False
    return any(SUMMARY_PROPERTY in chunk.entity_path for chunk in properties)


@contextmanager
def receiving(port: int, path: Path) -> Iterator[tuple["subprocess.Popen[bytes]", Callable[[], int]]]:
    """A real viewer without a window that saves the rows it receives, and their number so far."""

    def received() -> int:
        return len(received_s(path))

    command = [str(viewer_executable()), "--bind", "127.0.0.1", "--port", str(free_port()), "--save", str(path)]
    with subprocess.Popen([*command, live_address(port)], env={**os.environ, "RUST_LOG": "off"}) as viewer:
        try:
            yield viewer, received
        finally:
            viewer.kill()


def test_a_port_in_use_is_refused() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(BadInputError, match=f"live port {port}: .*choose another port"):
            Recording(None, properties={}, blocking=True, live_port=port)


def test_the_hint_is_the_command_that_attaches() -> None:
    assert live_hint(9876) == ("live view: run 'hil live --port 9876' on this machine; with --web in a browser")


@linux_only
def test_without_a_display_the_browser_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    path = tmp_path / "run.rrd"
    path.write_bytes(b"RRF2")
    assert not has_display()
    assert not show_live(9876)
    with pytest.raises(BadInputError) as refusal:
        view(path, web=False)
    assert str(refusal.value) == f"no display to show {path} on; use hil view {path} --web and a browser"


def test_what_is_no_recording_is_not_opened(tmp_path: Path) -> None:
    for name, content in {"empty.rrd": b"", "text.rrd": b"text"}.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(BadInputError, match=name):
            view(tmp_path / name, web=True)
    with pytest.raises(BadInputError, match="No such file"):
        view(tmp_path / "missing.rrd", web=True)


_VIEW_WITHOUT_A_WINDOW = """
import sys
from pathlib import Path
from hil.cli.output import end_in_order
from hil.addons.report import viewer
command = viewer.viewer_command
viewer.has_display = lambda: True
viewer.viewer_command = lambda *options: command("--headless", *options)
end_in_order()
print(*command(), flush=True)
viewer.view(Path(sys.argv[1]), web=sys.argv[2] == "web", say=lambda text: print(text, flush=True))
"""


@contextmanager
def viewing(path: Path, how: str) -> Iterator["subprocess.Popen[str]"]:
    command = [sys.executable, "-c", _VIEW_WITHOUT_A_WINDOW, str(path), how]
    with subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True, text=True) as viewer:
        assert viewer.stdout is not None
        viewer.stdout.readline()
        yield viewer


@pytest.fixture
def empty(tmp_path: Path) -> Path:
    path = tmp_path / "run.rrd"
    with Recording(path, properties={}, blocking=True) as recording:
        recording.finish({})
    return path


@linux_only
@pytest.mark.parametrize("ends", [signal.SIGINT, signal.SIGTERM])
def test_a_browser_is_served_on_the_loopback_interface_until_interrupted(empty: Path, ends: signal.Signals) -> None:
    with viewing(empty, "web") as viewer:
        assert viewer.stdout is not None
        sentence = viewer.stdout.readline()
        address = next(word for word in sentence.split() if word.startswith("http://127.0.0.1:"))
        page_port = int(address.split(":")[2].split("/")[0])
        data_port = int(address.split("%3A")[2].split("%2F")[0])
        assert listening_addresses(page_port) == listening_addresses(data_port) == LOOPBACK
        with urllib.request.urlopen(f"http://127.0.0.1:{page_port}/") as page:
            assert b"<html" in page.read().lower()
            assert page.headers["Content-Security-Policy"] == NOTHING_ELSEWHERE
        viewer.send_signal(ends)
        assert viewer.wait() == 0
    assert listening_addresses(page_port) == listening_addresses(data_port) == set()


@linux_only
@pytest.mark.parametrize(("ends", "code"), [(signal.SIGTERM, 0), (signal.SIGKILL, -signal.SIGKILL)])
def test_a_viewer_ends_with_the_command_that_opened_it(empty: Path, ends: signal.Signals, code: int) -> None:
    def children(pid: int) -> list[int]:
        return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]

    with viewing(empty, "window") as viewer:
        wait_for(lambda: children(viewer.pid))
        (own,) = children(viewer.pid)
        viewer.send_signal(ends)
        assert viewer.wait() == code
    wait_for(lambda: not is_running(own))


LATE_S = 40.0
HALF_AN_HOUR_S = 1800.0


@linux_only
def test_a_viewer_that_connects_late_gets_half_an_hour(tmp_path: Path) -> None:
    """A real client receives 40 s that the server kept, in the batches of a live view; 45 times that must fit."""
    port, received = free_port(), tmp_path / "received.rrd"
    sink = rr.GrpcServerSink("127.0.0.1", port, server_memory_limit=MEMORY_LIMIT)
    told = properties(load("paper_circle"))
    stream = Stream(
        sink, recording_id="late", signals=SIGNAL_NAMES, properties=told, make_drawing=RunDrawing, live=True
    )
    rows = round(LATE_S / LIVE_PERIOD_S)
    table = np.tile(circle_table(1000)[:: round(LIVE_PERIOD_S / PERIOD_S)], (rows // 50, 1))
    table[:, INDEX["loop.tick"]] = np.arange(rows)
    table[:, INDEX["loop.t_s"]] = np.arange(rows) * LIVE_PERIOD_S
    for piece in np.split(table, rows // round(BATCH_S / LIVE_PERIOD_S)):
        stream.draw(piece)
    stream.flush()
    with receiving(port, received) as (_, count):
        wait_for(lambda: count() == rows)
    assert received.stat().st_size * HALF_AN_HOUR_S / LATE_S < 512 << 20
    lengths = [len(chunk.to_record_batch()) for chunk in rrc.RrdReader(received).stream().filter(content="/ctrl/**")]
    assert np.median(lengths) == BATCH_S / LIVE_PERIOD_S
    stream.close()
