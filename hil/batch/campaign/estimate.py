"""How long a campaign takes: a few of its runs are timed in a process of their own."""

import math
from typing import NamedTuple

from hil.batch.campaign.campaign import Campaign
from hil.batch.campaign.jobs import NEVER, WORK
from hil.batch.pool import Performer

_TIMED = 3
_LIMIT_S = 120.0
_BETWEEN_S = 1.0
"""What a run in real time takes beside its own time."""


class Estimate(NamedTuple):
    """``run_s`` is what one run takes on one worker [s], ``total_s`` all of those that are left [s]."""

    run_s: float
    total_s: float


def estimate(campaign: Campaign, left: int, workers: int) -> Estimate:
    """Return how long so many runs take. Runs in real time are not tried: nothing moves for an estimate."""
    if campaign.in_real_time or campaign.on_bench:
        run_s = campaign.longest_s + _BETWEEN_S
    else:
        runs = campaign.runs
        timed = [runs[place * (len(runs) - 1) // (_TIMED - 1)] for place in range(_TIMED)]
        performer = Performer(WORK, _LIMIT_S)
        try:
            performer.perform(campaign.job(timed[0], NEVER))  # it has to import and to open its FMU
            said = [performer.perform(campaign.job(run, NEVER)) for run in timed]
        finally:
            performer.close()
        run_s = sum(one.wall_s for one in said) / _TIMED
    return Estimate(run_s, run_s * math.ceil(left / workers))
