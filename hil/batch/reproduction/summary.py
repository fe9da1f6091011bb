"""The summary of a reproduction as plain data: what ``hil reproduce --json`` prints and ``summary.json`` holds."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from hil.batch.reproduction import published
from hil.batch.reproduction.assumptions import assumptions
from hil.batch.reproduction.plan import Result
from hil.batch.reproduction.verdicts import Verdict

FORMAT = 1
"""Version of the summary: raised for changes that a reader has to know of."""
PAPER = (
    "Nguyen Minh et al. 2023, An Adaptive Fuzzy Dynamic Surface Control Tracking Algorithm for Mecanum Wheeled "
    "Mobile Robot"
)
CIRCLE_FIGURES = ("tracked_s", "t10_s", "steady_rms_m", "steady_max_m", "heading_rad")
DELAY_FIGURES = ("transition_s", "steady_rms_m", "steady_max_m", "amplitude_m", "frequency_hz")
TRANSITION_FIGURES = ("from_m", "transition_s")
_FIGURES = {
    "circle": CIRCLE_FIGURES,
    "experiment": ("driven_s", *TRANSITION_FIGURES, *DELAY_FIGURES[1:]),
    "delay": DELAY_FIGURES,
    "transition": TRANSITION_FIGURES,
}


def summarise(
    results: Sequence[Result],
    verdicts: Sequence[Verdict],
    *,
    quick: bool,
    folder: Path,
    pictures: Sequence[str],
    recordings: Sequence[str],
    wall_s: float,
) -> dict[str, Any]:
    """Return the summary.

    Each of ``circle``, ``experiment``, ``delay`` and ``transition`` is a list of rows: what the case is, its figures
    (None where one is not defined) and ``failure``. ``paper`` has the printed figures, ``verdicts`` the verdicts on
    them, ``pictures`` and ``recordings`` names of files in ``folder``.
    """
    return {
        "format": FORMAT,
        "source": PAPER,
        "quick": quick,
        "paper": [printed._asdict() for printed in published.FIGURES],
        "filters_s": {"common": published.COMMON_FILTER_S, "short": published.SHORT_FILTER_S},
        "assumptions": [assumption._asdict() for assumption in assumptions()],
        **{group: list(_rows(group, figures, results)) for group, figures in _FIGURES.items()},
        "verdicts": [verdict._asdict() for verdict in verdicts],
        "folder": str(folder),
        "pictures": list(pictures),
        "recordings": list(recordings),
        "wall_s": wall_s,
    }


def failures(summary: Mapping[str, Any]) -> list[str]:
    """Return the runs of a summary that did not come to their end, each with what ended it."""
    rows = (row for group in _FIGURES for row in summary[group])
    return [f"{row['name']}: {row['failure']}" for row in rows if row["failure"] is not None]


def _rows(group: str, figures: Sequence[str], results: Sequence[Result]) -> Iterator[Mapping[str, Any]]:
    for case, found, failure in results:
        if case.group == group:
            yield {"name": case.name, **case.row, **{name: found.get(name) for name in figures}, "failure": failure}
