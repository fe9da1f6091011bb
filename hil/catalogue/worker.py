"""A worker: ``python -m hil.catalogue.worker`` takes jobs as lines of JSON and answers each with its verdict.

What raises in another thread, or where nothing can be raised, becomes the verdict; what raises in the run itself ends
this process, which is a verdict too.
"""

import json
import os
import sys
import threading
import traceback
from pathlib import Path
from types import TracebackType

from hil.catalogue.runs import Job, lost, perform


def main() -> int:
    """Serve until the jobs end."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what a law prints must not get between the answers
    stray: list[str] = []

    def keep(kind: type[BaseException], error: BaseException | None, trace: TracebackType | None) -> None:
        stray.append(_words(kind, error, trace))

    threading.excepthook = lambda args: keep(args.exc_type, args.exc_value, args.exc_traceback)
    sys.unraisablehook = lambda args: keep(args.exc_type, args.exc_value, args.exc_traceback)
    for line in sys.stdin:
        job = Job(**json.loads(line))
        verdict = perform(job)
        if stray:
            verdict = lost(job, f"traceback: {stray[0]}", verdict.wall_s)
            stray.clear()
        answers.write(json.dumps(verdict._asdict()) + "\n")
        answers.flush()
    return 0


def _words(kind: type[BaseException], error: BaseException | None, trace: TracebackType | None) -> str:
    """Return what was raised and where, in one line."""
    frames = traceback.extract_tb(trace)
    where = f" at {Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
    return f"{kind.__name__}: {error}{where}"


if __name__ == "__main__":
    sys.exit(main())
