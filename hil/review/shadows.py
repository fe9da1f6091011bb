"""How the set points of a recorded run's shadows differ from its command."""

from collections.abc import Mapping

from hil.judge.shadows import CommandDifference, ShadowDifferences, command_difference, shadow_signals
from hil.review.contents import Series

__all__ = ["CommandDifference", "command_difference", "shadow_differences", "shadow_signals"]


def shadow_differences(signals: Mapping[str, Series]) -> dict[str, dict[str, CommandDifference]]:
    """Return how each shadow's set points differ from the command, by shadow and by the command's signal.

    ``signals`` are those of a run with the shadows' among them. Ticks without a command or without a value of the
    shadow are left out; a shadow that never had a value beside a command has no entry.
    """
    differences = ShadowDifferences(signals)
    if differences.signals:
        differences.add(signals)
    return differences.results()
