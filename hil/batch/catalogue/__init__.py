"""The fault catalogue: every fault alone and in pairs, over every kind of link, each run judged for safety."""

import contextlib
import os
from collections.abc import Callable

from hil.batch.catalogue import plan
from hil.batch.catalogue.plan import Asked
from hil.batch.catalogue.runs import WORK, Verdict, scenario
from hil.batch.old_pool import counted, perform_all

__all__ = ["Asked", "Verdict", "catalogue"]

Tell = Callable[[int, int, Verdict], None]


def catalogue(
    asked: Asked,
    *,
    pairs: bool = False,
    realtime: bool = False,
    jobs: int | None = None,
    limit_s: float = 60.0,
    tell: Tell | None = None,
) -> list[Verdict]:
    """Run the catalogue and return a verdict on each run.

    ``jobs`` is the number of processes; what runs in real time runs alone, after all else. A run that takes more than
    ``limit_s`` of wall-clock time is ended. ``tell`` gets how many are done, of how many, and the newest verdict.

    Raises BadInputError for a link or kind that does not exist, and for a base scenario that cannot be used.
    """
    plan.check(asked)
    plan.check_motors(asked, pairs=pairs, realtime=realtime)
    lockstep = plan.alone(asked) + (plan.pairs(asked) if pairs else [])
    in_real_time = plan.alone(asked, "realtime") if realtime else []
    scenario(lockstep[0])
    count = counted(tell, len(lockstep) + len(in_real_time))
    asked.recordings.mkdir(parents=True, exist_ok=True)
    verdicts = perform_all(WORK, lockstep, jobs or os.cpu_count() or 1, limit_s, count)
    verdicts += perform_all(WORK, in_real_time, 1, limit_s, count)
    with contextlib.suppress(OSError):  # what is not empty has recordings to look at
        asked.recordings.rmdir()
    return verdicts
