"""Whether a run kept within its ``[allow]``: what no fault of the scenario explains, counted against its limits."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from hil.scenario.allow import AllowTable, most


class Counted(NamedTuple):
    """How often something happened in a run, and how often of that no fault of the scenario explains it."""

    all: int
    unexplained: int


def allow_figures(allow: AllowTable, counted: Mapping[str, Counted], ticks: int) -> list[dict[str, Any]]:
    """Return what became of each limit of ``[allow]``, in its order, in words and numbers.

    ``counted`` has a count for each key of the table, ``ticks`` is how many the run had.
    """
    return [
        _judged(name, field.description or "", getattr(allow, name), counted[name], ticks)
        for name, field in AllowTable.model_fields.items()
    ]


def _judged(name: str, meaning: str, limit: int | str, counted: Counted, ticks: int) -> dict[str, Any]:
    allowed = most(limit, ticks)
    passed = counted.unexplained <= allowed
    share = f"{allowed}, {limit}" if isinstance(limit, str) else f"{allowed}"
    verdict = "as allowed" if passed else "find the cause, or raise it"
    sentence = (
        f"{name}: {counted.unexplained} of {ticks} {meaning}; no fault of the scenario explains them, and "
        f"allow.{name} permits {share}: {verdict}"
    )
    return {
        "name": name,
        "passed": passed,
        "all": counted.all,
        "unexplained": counted.unexplained,
        "limit": limit,
        "text": sentence,
    }
