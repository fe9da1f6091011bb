"""Requests of a process to the operating system for a run in real time, and that it gives all back."""

import ctypes
import errno
import gc
import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

import hil
from hil.judge.figure_text import figure_rows
from hil.judge.judged_run import JudgedRun
from hil.runtime import realtime
from hil.runtime.assembly import RunOptions, run_scenario
from hil.runtime.realtime import GC_THRESHOLD, parse_cpus, real_time
from hil.scenario import RealtimeTable, load
from tests.support.processes import device, environment

linux = pytest.mark.skipif(sys.platform != "linux", reason="the scheduler asked is Linux's")

_AS_NOBODY = """
import json, os, resource, sys
from hil.runtime.realtime import real_time
from hil.scenario import RealtimeTable
resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))
if os.geteuid() == 0:
    os.setuid(65534)
with real_time(RealtimeTable(40, (4096,), True)) as granted:
    print(json.dumps([granted.figures(), os.sched_getscheduler(0)]))
"""


def _state() -> tuple[object, ...]:
    """Return all that ``real_time`` may change of this thread and process."""
    mine = (os.sched_getscheduler(0), os.sched_getparam(0).sched_priority, os.sched_getaffinity(0))
    slack, status = (Path(f"/proc/self/{name}").read_text() for name in ("timerslack_ns", "status"))
    locked = [line for line in status.splitlines() if line.startswith("VmLck")]
    return (*mine, slack, locked, gc.get_threshold(), gc.get_freeze_count(), sys.getswitchinterval())


@linux
def test_every_setting_is_taken_back() -> None:
    gc.collect()
    before = _state()
    with real_time(RealtimeTable(40, (min(os.sched_getaffinity(0)),), True)) as granted:
        within = _state()
        assert gc.get_threshold()[0] == GC_THRESHOLD
        assert len(os.sched_getaffinity(0)) == 1
    assert within != before
    assert _state() == before
    names = {setting.name for setting in granted.settings}
    assert names == {
        *("garbage collector", "switch interval", "timer slack", "idle states", "processors", "memory", "priority")
    }


@linux
def test_what_is_not_wanted_is_not_asked_for() -> None:
    before = _state()[:3]
    with real_time(RealtimeTable(0, (), False)) as granted:
        assert _state()[:3] == before
    assert not {"priority", "memory"} & {setting.name for setting in granted.settings}


@linux
def test_a_refusal_is_a_sentence_that_says_what_to_do() -> None:
    done = subprocess.run(
        [sys.executable, "-c", _AS_NOBODY], capture_output=True, text=True, check=False, env=environment()
    )
    assert done.returncode == 0, done.stderr
    figures, policy = json.loads(done.stdout)
    refused = figures["refused"]
    assert policy == os.SCHED_OTHER
    assert refused["priority"].startswith("SCHED_FIFO 40: refused (Operation not permitted), the user's rtprio is 0; ")
    assert refused["memory"].startswith("memory: not locked, for only 64 KiB may be; give the user memlock unlimited")
    there = ", ".join(map(str, sorted(os.sched_getaffinity(0))))
    assert refused["processors"] == (
        f"processors 4096: refused (Invalid argument); this process has {there}: set realtime.cpus to some of these"
    )
    assert set(figures["granted"]) >= {"garbage collector", "switch interval", "timer slack"}


@linux
def test_what_the_kernel_refuses_is_told_and_what_it_costs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A C library that refuses all, and a file that may not be written: it is a folder."""

    def refuses(*_: object) -> int:
        ctypes.set_errno(errno.EPERM)
        return -1

    monkeypatch.setattr(realtime, "_libc", lambda: SimpleNamespace(prctl=refuses, mlockall=refuses))
    monkeypatch.setattr(realtime, "memory_limit_bytes", lambda: None)
    monkeypatch.setattr(realtime, "DMA_LATENCY", tmp_path)
    with real_time(RealtimeTable(0, (), True)) as granted:
        assert granted.figures()["refused"] == {
            "timer slack": "timer slack: refused (Operation not permitted); timers may be up to 50 µs late",
            "idle states": (
                f"idle states: {tmp_path} may not be written (Is a directory); give the user's group that right in a "
                "udev rule, or wakes from idle are late"
            ),
            "memory": "memory: not locked (Operation not permitted); a page that was swapped out makes a tick late",
        }


@linux
def test_a_robot_in_another_process_says_what_it_was_refused() -> None:
    with device("paper_circle", "--mode", "realtime", "--link", "serial:pty", "--set", "realtime.cpus=[4096]") as robot:
        assert robot.process.stdout is not None
        assert robot.process.stdout.readline().startswith("not granted: processors 4096: refused (")


def test_where_it_is_not_linux_one_sentence_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.platform", "darwin")
    with real_time(RealtimeTable(40, (0,), True)) as granted:
        assert gc.get_threshold()[0] == GC_THRESHOLD
    refused = "priority, processors and locked memory: only Linux is asked for these"
    assert granted.figures()["refused"] == {"priority": refused}


@linux
def test_children_begin_as_ordinary() -> None:
    ask = [sys.executable, "-c", "import os; print(os.sched_getscheduler(0))"]
    with real_time(RealtimeTable(40, (), False)) as granted:
        child = subprocess.run(ask, capture_output=True, text=True, check=True)
    if "priority" in granted.figures()["refused"]:
        pytest.skip("a real-time priority takes root or a limit")
    assert int(child.stdout) == os.SCHED_OTHER


@linux
def test_a_thread_that_has_ended_is_not_given_anything_back() -> None:
    done = threading.Event()
    thread = threading.Thread(target=done.wait)
    thread.start()
    assert thread.native_id is not None
    with real_time(RealtimeTable(1, (), False), [thread.native_id]):
        done.set()
        thread.join()
    assert os.sched_getscheduler(0) == os.SCHED_OTHER


def test_processors_are_read_as_the_kernel_writes_them() -> None:
    assert parse_cpus("0-3,7\n") == (0, 1, 2, 3, 7)
    assert parse_cpus("\n") == ()


@linux
@pytest.mark.alone
def test_a_run_in_real_time_says_what_was_granted_and_leaves_the_process_as_it_was() -> None:
    gc.collect()
    before = _state()
    run = hil.run("circle_speed", mode="realtime", set={"loop.duration_s": 0.5, "realtime.priority": 1})
    assert run.failure is None
    said = run.metrics["realtime"]
    assert "garbage collector" in said["granted"]
    assert "priority" in said["granted"] | said["refused"]
    assert _state() == before
    late = run.metrics["lateness_us"]
    assert sum(late["counts"]) == run.metrics["ticks"]
    assert 0.0 < late["p50"] <= late["p99"] <= late["p99.9"] <= late["max"]


def test_ticks_leave_nothing_for_the_garbage_collector() -> None:
    found = []

    @contextmanager
    def watch(_: object) -> Iterator[None]:
        gc.collect()
        gc.disable()
        try:
            yield
            found.append(gc.collect())
        finally:
            gc.enable()

    run_scenario(load("circle_speed", set={"loop.duration_s": 1.0, "expect": []}), RunOptions(watch=watch))
    assert found == [0]


def test_a_run_says_in_words_how_late_it_was_and_what_it_was_refused() -> None:
    late = {"p50": 31.0, "p99": 65.4, "p99.9": 640.0, "max": 8700.0}
    said = {"granted": {"a": "timer slack: 1 ns", "b": "SCHED_FIFO 40"}, "refused": {"c": "memory: not locked"}}
    rows = list(figure_rows(JudgedRun(figures={"lateness_us": late}, realtime=said)))
    assert ("late p50, 99, 99.9, max", "31, 65, 640, 8700 µs") in rows
    assert ("granted", "timer slack: 1 ns; SCHED_FIFO 40") in rows
    assert ("not granted", "memory: not locked") in rows
    still = JudgedRun(figures={"lateness_us": dict.fromkeys(late, 0.0)})
    assert list(figure_rows(still)) == []


def test_a_run_in_lockstep_asks_for_nothing() -> None:
    run = hil.run("circle_speed", set={"loop.duration_s": 0.1})
    assert run.metrics["realtime"] is None
    assert run.metrics["lateness_us"]["max"] == 0.0


@linux
@pytest.mark.parametrize("has_file", [False, True])
def test_what_was_granted_is_told_in_figures_and_so_is_what_a_machine_lacks(
    has_file: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = min(os.sched_getaffinity(0))
    (tmp_path / "isolated").write_text(f"{one}\n")
    latency = tmp_path / "latency"
    if has_file:
        latency.touch()
    monkeypatch.setattr(realtime, "ISOLATED", tmp_path / "isolated")
    monkeypatch.setattr(realtime, "DMA_LATENCY", latency)
    with real_time(RealtimeTable(0, (), False)) as granted:
        assert sys.getswitchinterval() == pytest.approx(1e-4)
        assert os.sched_getaffinity(0) == {one}
        if has_file:
            assert latency.read_bytes() == bytes(4), "0 µs, as 32 bits"
    idle = {"idle states": f"idle states: this machine has no {latency}, by which to forbid deep ones"}
    told = {
        "garbage collector": "garbage collector: frozen, waits for 100000 new objects",
        "switch interval": "switch interval: 0.1 ms",
        "timer slack": "timer slack: 1 ns",
        "processors": f"processors: {one}, isolated",
    }
    if has_file:
        idle, told = {}, told | {"idle states": "idle states: deep ones are forbidden"}
    assert granted.figures() == {"granted": told, "refused": idle}


@linux
def test_limits_and_capabilities_are_those_of_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    import resource

    limits = {resource.RLIMIT_RTPRIO: (7, 9), resource.RLIMIT_MEMLOCK: (65_536, 70_000)}
    monkeypatch.setattr(resource, "getrlimit", limits.__getitem__)
    assert (realtime.priority_limit(), realtime.memory_limit_bytes()) == (7, 65_536)
    limits.update(dict.fromkeys(limits, (resource.RLIM_INFINITY,) * 2))
    assert (realtime.priority_limit(), realtime.memory_limit_bytes()) == (99, None)
    status = Path("/proc/self/status").read_text()
    effective = int(next(line.split()[1] for line in status.splitlines() if line.startswith("CapEff:")), 16)
    assert [realtime.has_capability(bit) for bit in range(41)] == [bool(effective & 2**bit) for bit in range(41)]
