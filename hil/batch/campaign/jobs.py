"""A run to do, as it goes to the process that does it; what gives runs out needs nothing of a robot."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from hil.batch.campaign.rows import LOST, Said
from hil.batch.pool import Work

NEVER, IF_FAILED, ALWAYS = "never", "if failed", "always"
"""When a run is recorded."""


class Job(NamedTuple):
    """A run to do, as plain values: its key, its scenario, when it is recorded, into which file."""

    key: str
    scenario: Mapping[str, Any]
    recorded: str
    recording: str
    allow_motion: bool


def lost(_job: Job, words: str, wall_s: float) -> Said:
    """Return what is said of a run whose process said nothing."""
    return Said({}, LOST, words, wall_s)


WORK = Work("hil.batch.campaign.worker", Said, lost)
"""What the pool is told of a run of a campaign."""
