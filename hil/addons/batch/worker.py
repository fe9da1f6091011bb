"""A process that does jobs of one kind: ``python -m hil.addons.batch.worker MODULE:FUNCTION LIFELINE``.

It reads jobs as lines of JSON from stdin and writes one outcome a line to stdout. An exception in another thread, or in
a place where it cannot be raised (such as ``__del__``), makes the job lost. One in the job itself ends the process,
which the pool notices. When the pool has ended, the process ends at once.
"""

import json
import os
import pkgutil
import sys
import threading
import time
import traceback
from pathlib import Path
from typing import Any

from hil.addons.batch.job import FOREIGN, LOST, REFUSED, Job, Outcome, plain
from hil.addons.batch.keys import key_of
from hil.addons.batch.pool import READY
from hil.core.errors import BadInputError
from hil.core.subprocesses import hold_on
from hil.scenario import from_plain


def main(kind: str) -> int:
    """Serve until there are no more jobs, and return the exit code."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what a law prints must not get between the outcomes
    work = pkgutil.resolve_name(kind)
    stray: list[str] = []

    def keep(args: Any) -> None:
        frames = traceback.extract_tb(args.exc_traceback)
        where = f" at {Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
        stray.append(f"{args.exc_type.__name__}: {args.exc_value}{where}")

    threading.excepthook = sys.unraisablehook = keep
    answers.write(READY)
    answers.flush()
    for line in sys.stdin:
        job = Job(**json.loads(line))
        began = time.monotonic()
        scenario = from_plain(job.scenario)
        try:
            is_planned = key_of(scenario, job.kind, job.options) == job.key
            outcome: Outcome = work(job, scenario) if is_planned else Outcome(job.key, FOREIGN)
        except BadInputError as error:
            outcome = Outcome(job.key, REFUSED, str(error))
        if stray:
            outcome = Outcome(job.key, LOST, f"traceback: {stray[0]}")
            stray.clear()
        answers.write(json.dumps(plain(outcome._replace(wall_s=time.monotonic() - began))) + "\n")
        answers.flush()
    return 0


if __name__ == "__main__":
    hold_on(sys.argv[2])
    sys.exit(main(sys.argv[1]))
