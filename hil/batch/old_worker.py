"""The other end of ``hil.batch.old_pool``: a process that takes jobs as lines of JSON and answers each.

What raises in another thread, or where nothing can be raised, becomes the answer; what raises in the job itself ends
the process, which is an answer too. When whoever gave the job is gone, the process ends at once.
"""

import json
import os
import queue
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import TypeVar

from hil.batch.old_pool import READY, Plain

J = TypeVar("J", bound=Plain)
A = TypeVar("A", bound=Plain)


def serve(job_type: type[J], perform: Callable[[J], A], lost: Callable[[J, str, float], A]) -> int:
    """Serve until the jobs end; the arguments are as in ``hil.batch.old_pool.Work``, ``perform`` does a job."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what a law prints must not get between the answers
    stray: list[str] = []
    answers.write(READY)
    answers.flush()

    def keep(kind: type[BaseException], error: BaseException | None, trace: TracebackType | None) -> None:
        stray.append(_words(kind, error, trace))

    threading.excepthook = lambda args: keep(args.exc_type, args.exc_value, args.exc_traceback)
    sys.unraisablehook = lambda args: keep(args.exc_type, args.exc_value, args.exc_traceback)
    for line in _lines():
        job = job_type(**json.loads(line))
        began = time.monotonic()
        answer = perform(job)
        if stray:
            answer = lost(job, f"traceback: {stray[0]}", time.monotonic() - began)
            stray.clear()
        answers.write(json.dumps(answer._asdict()) + "\n")
        answers.flush()
    return 0


def _lines() -> Iterator[str]:
    """Yield the lines of stdin until it ends; when it ends during a job, whoever wanted that is gone, and so are we."""
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()
    is_idle = threading.Event()

    def read() -> None:
        for line in sys.stdin:
            lines.put(line)
        if not is_idle.is_set():
            os._exit(1)
        lines.put("")

    is_idle.set()
    threading.Thread(target=read, name="jobs", daemon=True).start()
    while line := lines.get():
        is_idle.clear()
        yield line
        is_idle.set()


def _words(kind: type[BaseException], error: BaseException | None, trace: TracebackType | None) -> str:
    """Return what was raised and where, in one line."""
    frames = traceback.extract_tb(trace)
    where = f" at {Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
    return f"{kind.__name__}: {error}{where}"
