"""A wall-clock time limit for a tick: a law that does not return is detected, reported and ended."""

import ctypes
import os
import sys
import threading
import time
import traceback
from collections.abc import Callable
from types import FrameType
from typing import Self

from hil.core.errors import OverdueError

_LOOKS = 8  # checks during one time limit
_LONGEST_LOOK_S = 1.0
_GRACE_S = 1.0  # from the exception in the tick to the end of the process
_LAST_WORDS_S = 15.0  # time that ``last_words`` has before that end
_PRINT_S = 2.0
_FRAMES = 8  # innermost stack frames that are printed: the law's, and its callers'


class TickOverdue(BaseException):
    """Raised in the middle of a tick that took too long. ``except Exception`` in a law does not catch it."""

    sentence = ""

    def __str__(self) -> str:
        return self.sentence


class TickWatch:
    """Ends a tick that takes longer than ``limit_s`` of wall-clock time; 0 or infinity means none. A context manager.

    The thread that enters the context adds 1 to ``turn`` when a tick begins and 1 when it ends, which is the only cost
    of a tick. A background thread looks at ``turn``. When a tick is overdue, it raises TickOverdue in the first thread,
    which has to catch it. Where no exception can reach the tick (in a sleep or in C code), the watch calls
    ``last_words`` with a sentence, prints the innermost frames of the stack and the sentence, and ends the process with
    the exit code of OverdueError.

    The time between two ticks is not watched: waiting for robot and plant has limits of its own. Time in which this
    process did not run, because it was stopped or the machine suspended, is not counted. While a call into C holds
    Python's lock (the GIL) the watch cannot run either; most long calls release it.
    """

    def __init__(self, limit_s: float, t_s: Callable[[], float], last_words: Callable[[str], None]) -> None:
        self._limit_s = limit_s
        self._t_s = t_s
        self._last_words = last_words
        self._look_s = min(limit_s / _LOOKS, _LONGEST_LOOK_S)
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None
        self._ident = 0
        self.turn = 0

    def __enter__(self) -> Self:
        self._ident = threading.get_ident()
        if 0.0 < self._limit_s < float("inf"):
            self._thread = threading.Thread(target=self._watch, name="tick watch", daemon=True)
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        if self._thread is not None:
            self._thread.join()

    def _watch(self) -> None:
        turn, stood_s, looked_s, sentence = self.turn, 0.0, time.monotonic(), ""
        while not self._ended.wait(self._look_s):
            now_s = time.monotonic()
            passed_s, looked_s = min(now_s - looked_s, 2.0 * self._look_s), now_s
            if self.turn != turn or turn % 2 == 0:
                turn, stood_s, sentence = self.turn, 0.0, ""
                continue
            stood_s += passed_s
            if stood_s <= self._limit_s:
                continue
            frame = sys._current_frames().get(self._ident)
            if not sentence:
                sentence = self._sentence(frame)
                self._raise(sentence)
            elif stood_s > self._limit_s + _GRACE_S:
                self._end(sentence)

    def _sentence(self, frame: FrameType | None) -> str:
        where = "" if frame is None else f" at {frame.f_code.co_filename}:{frame.f_lineno}, in {frame.f_code.co_name}"
        return (
            f"the tick at t = {self._t_s():.3f} s did not end within {self._limit_s:g} s of wall-clock time{where}: a "
            "law that does not return? loop.tick_limit_s is the limit, 0 for none"
        )

    def _raise(self, sentence: str) -> None:
        overdue = type("TickOverdue", (TickOverdue,), {"sentence": sentence})
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(self._ident), ctypes.py_object(overdue))

    def _end(self, sentence: str) -> None:
        """End the process, because the control thread no longer runs Python code."""
        stack = "".join(traceback.format_stack(sys._current_frames().get(self._ident), _FRAMES))
        # The sentence is printed last, because the last line of a worker's output is shown to the user.
        _say(lambda: self._last_words(sentence), _LAST_WORDS_S)
        _say(lambda: print(f"{stack}hil: {sentence}", file=sys.stderr, flush=True), _PRINT_S)
        os._exit(OverdueError.exit_code)


def _say(words: Callable[[], None], limit_s: float) -> None:
    """Call ``words`` and wait at most ``limit_s``: the stuck thread may hold a lock that it needs."""
    thread = threading.Thread(target=words, name="last words", daemon=True)
    thread.start()
    thread.join(limit_s)
