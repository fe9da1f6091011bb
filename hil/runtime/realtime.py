"""Asks the operating system for real-time behaviour: priority, processors, locked memory, exact timers.

A process takes the settings for the duration of a run and restores them at the end. A refusal does not end the run:
some ticks are later, and the summary gives the reason. LIMITS.md shows how to set a machine up.
"""

import contextlib
import ctypes
import gc
import os
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from hil.scenario.tables import RealtimeTable

SWITCH_INTERVAL_S = 1e-4
GC_THRESHOLD = 100_000
ISOLATED = Path("/sys/devices/system/cpu/isolated")
DMA_LATENCY = Path("/dev/cpu_dma_latency")
CAP_IPC_LOCK = 14
CAP_SYS_NICE = 23
LIMITS_REMEDY = "give the user {item} in /etc/security/limits.d (hil doctor prints the line), or run with {capability}"
_PR_SET_TIMERSLACK = 29
_PR_GET_TIMERSLACK = 30
_TIMER_SLACK_NS = 1
_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4


class Setting(NamedTuple):
    """The answer to one request, as a sentence."""

    name: str
    granted: bool
    sentence: str


class RealTime(NamedTuple):
    """The real-time settings of a process during a run: ``settings`` has the answer to each request."""

    settings: Sequence[Setting]

    def figures(self) -> dict[str, dict[str, str]]:
        """Return two dicts of sentences by setting, under ``granted`` and ``refused``."""
        return {
            kind: {name: sentence for name, granted, sentence in self.settings if granted is expected}
            for kind, expected in (("granted", True), ("refused", False))
        }


@contextlib.contextmanager
def real_time(options: RealtimeTable, threads: Sequence[int] = ()) -> Iterator[RealTime]:
    """Request the ``options`` settings for the calling thread and ``threads`` (native ids); restore all at the end.

    Processes and threads that these start meanwhile begin with ordinary priority.
    """
    every = (threading.get_native_id(), *threads)
    with contextlib.ExitStack() as undo:
        requests: dict[str, _Request] = {
            "garbage collector": _quieten_collector,
            "switch interval": _shorten_switch_interval,
        }
        if sys.platform == "linux":
            requests |= {
                "timer slack": _tighten_timers,
                "idle states": _stay_awake,
                "processors": lambda undo: _pin(options.cpus, every, undo),
                "memory": lambda undo: _lock_memory(undo) if options.lock_memory else None,
                # Last, so that no other process waits for the requests above.
                "priority": lambda undo: _raise_priority(options.priority, every, undo) if options.priority else None,
            }
        else:
            requests["priority"] = _refuse
        yield RealTime(
            [setting for name, request in requests.items() if (setting := _answer(name, request, undo)) is not None]
        )


class _RefusedError(Exception):
    """A request was refused; the text gives the reason and the remedy."""


_Request = Callable[[contextlib.ExitStack], str | None]


def _answer(name: str, request: _Request, undo: contextlib.ExitStack) -> Setting | None:
    """Make one request; None if it was not wanted. After a refusal, its partial changes are undone at once."""
    with contextlib.ExitStack() as attempt:
        try:
            sentence = request(attempt)
        except _RefusedError as refused:
            return Setting(name, False, str(refused))
        undo.enter_context(attempt.pop_all())
    return None if sentence is None else Setting(name, True, sentence)


def _refuse(_: contextlib.ExitStack) -> str:
    raise _RefusedError("priority, processors and locked memory: only Linux is asked for these")


def _quieten_collector(undo: contextlib.ExitStack) -> str:
    """Freeze the objects that exist, so that the garbage collector skips them, and let it run rarely.

    It is not switched off: a law that creates reference cycles would use up all memory.
    """
    thresholds = gc.get_threshold()
    had_frozen = gc.get_freeze_count() > 0
    gc.collect()
    gc.freeze()
    gc.set_threshold(GC_THRESHOLD, *thresholds[1:])

    def restore() -> None:
        gc.set_threshold(*thresholds)
        if not had_frozen:
            gc.unfreeze()

    undo.callback(restore)
    return f"garbage collector: frozen, waits for {GC_THRESHOLD} new objects"


def _shorten_switch_interval(undo: contextlib.ExitStack) -> str:
    """Let another thread that holds the interpreter give it up sooner."""
    undo.callback(sys.setswitchinterval, sys.getswitchinterval())
    sys.setswitchinterval(min(SWITCH_INTERVAL_S, sys.getswitchinterval()))
    return f"switch interval: {sys.getswitchinterval() * 1e3:g} ms"


def _tighten_timers(undo: contextlib.ExitStack) -> str:
    """Let the kernel wake this thread on time. By default it may wait 50 µs more, to save power."""
    prctl = _libc().prctl
    before_ns = prctl(_PR_GET_TIMERSLACK, 0, 0, 0, 0)
    if before_ns < 0 or prctl(_PR_SET_TIMERSLACK, _TIMER_SLACK_NS, 0, 0, 0):
        raise _RefusedError(f"timer slack: refused ({_errno_words()}); timers may be up to 50 µs late")
    # 0 would restore the thread's default value instead.
    undo.callback(prctl, _PR_SET_TIMERSLACK, before_ns or 1, 0, 0, 0)
    return f"timer slack: {_TIMER_SLACK_NS} ns"


def _stay_awake(undo: contextlib.ExitStack) -> str:
    """Keep the processors out of deep sleep, from which they wake slowly, as long as the file is open."""
    if not DMA_LATENCY.exists():
        raise _RefusedError(f"idle states: this machine has no {DMA_LATENCY}, by which to forbid deep ones")
    try:
        file = undo.enter_context(DMA_LATENCY.open("wb", buffering=0))
        file.write((0).to_bytes(4, sys.byteorder))
    except OSError as error:
        raise _RefusedError(
            f"idle states: {DMA_LATENCY} may not be written ({error.strerror}); give the user's group that right in a "
            "udev rule, or wakes from idle are late"
        ) from error
    return "idle states: deep ones are forbidden"


def isolated_cpus() -> tuple[int, ...]:
    """Return the processors on which the kernel schedules nothing on its own (isolcpus=)."""
    try:
        return parse_cpus(ISOLATED.read_text("ascii"))
    except OSError:
        return ()


def parse_cpus(text: str) -> tuple[int, ...]:
    """Return the processors of a list as the kernel writes it.

    >>> parse_cpus("1,4-6")
    (1, 4, 5, 6)
    """
    found: list[int] = []
    for part in filter(None, text.strip().split(",")):
        first, _, last = part.partition("-")
        found += range(int(first), int(last or first) + 1)
    return tuple(found)


def _pin(cpus: tuple[int, ...], threads: Sequence[int], undo: contextlib.ExitStack) -> str | None:
    chosen = cpus or isolated_cpus()
    if not chosen:
        return None
    named = ", ".join(map(str, chosen))
    for thread in threads:
        before = os.sched_getaffinity(thread)
        try:
            os.sched_setaffinity(thread, chosen)
        except OSError as error:
            there = ", ".join(map(str, sorted(before)))
            raise _RefusedError(
                f"processors {named}: refused ({error.strerror}); this process has {there}: set realtime.cpus to some "
                "of these"
            ) from error
        undo.callback(_restore_cpus, thread, before)
    return f"processors: {named}{'' if cpus else ', isolated'}"


def _lock_memory(undo: contextlib.ExitStack) -> str:
    if int((_status("VmLck") or "0").split()[0]):
        return "memory: locked before already"
    limit = memory_limit_bytes()
    # With a limit, the lock might be granted now and a later allocation refused, in the middle of the run.
    if limit is not None and not has_capability(CAP_IPC_LOCK):
        remedy = LIMITS_REMEDY.format(item="memlock unlimited", capability="CAP_IPC_LOCK")
        raise _RefusedError(f"memory: not locked, for only {limit >> 10} KiB may be; {remedy}")
    libc = _libc()
    # On fault: otherwise all reserved address space would be filled with real memory now.
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT):
        raise _RefusedError(f"memory: not locked ({_errno_words()}); a page that was swapped out makes a tick late")
    undo.callback(libc.munlockall)
    return "memory: locked"


def _raise_priority(priority: int, threads: Sequence[int], undo: contextlib.ExitStack) -> str:
    if os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK in (os.SCHED_FIFO, os.SCHED_RR):
        return f"priority: {os.sched_getparam(0).sched_priority} in real time before already"
    for thread in threads:
        before = os.sched_getscheduler(thread), os.sched_getparam(thread)
        try:
            os.sched_setscheduler(thread, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
        except OSError as error:
            remedy = LIMITS_REMEDY.format(item=f"rtprio {priority}", capability="CAP_SYS_NICE")
            limit = f"the user's rtprio is {priority_limit()}"
            raise _RefusedError(f"SCHED_FIFO {priority}: refused ({error.strerror}), {limit}; {remedy}") from error
        undo.callback(_restore_priority, thread, *before)
    return f"SCHED_FIFO {priority}"


def _restore_cpus(thread: int, cpus: set[int]) -> None:
    if _is_ours(thread):
        os.sched_setaffinity(thread, cpus)


def _restore_priority(thread: int, policy: int, param: "os.sched_param") -> None:
    if _is_ours(thread):
        try:
            os.sched_setscheduler(thread, policy, param)
        except PermissionError:
            # Only root may clear SCHED_RESET_ON_FORK; for a thread with ordinary priority it makes no difference.
            os.sched_setscheduler(thread, policy | os.SCHED_RESET_ON_FORK, param)


def _is_ours(thread: int) -> bool:
    """Whether a thread of this process still runs; by now its id may belong to another process."""
    return Path(f"/proc/self/task/{thread}").exists()


def priority_limit() -> int:
    """Return the highest priority that this user's limits permit on Linux, 0 for none."""
    import resource

    limit, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    return 99 if limit == resource.RLIM_INFINITY else limit


def memory_limit_bytes() -> int | None:
    """Return how much memory this user's limits permit to lock on Linux; None for any amount."""
    import resource

    limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    return None if limit == resource.RLIM_INFINITY else limit


def has_capability(bit: int) -> bool:
    """Whether this process has an effective Linux capability."""
    return bool(int(_status("CapEff") or "0", 16) >> bit & 1)


def _status(key: str) -> str | None:
    try:
        text = Path("/proc/self/status").read_text("utf-8")
    except OSError:
        return None
    return next((line.partition(":")[2].strip() for line in text.splitlines() if line.startswith(f"{key}:")), None)


def _libc() -> Any:
    return ctypes.CDLL(None, use_errno=True)


def _errno_words() -> str:
    return os.strerror(ctypes.get_errno())
