"""The result of a run, as ``hil.run`` returns it and ``hil.load`` reads it back."""

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from hil.core.errors import HilError
from hil.core.extras import need
from hil.judge.results import Event, Signals
from hil.judge.verdict import run_lines, verdict_word
from hil.judge.words import why_not_passed
from hil.scenario import Scenario

if TYPE_CHECKING:
    import pandas as pd

_REASON_LETTERS = 90


@dataclass(frozen=True, repr=False)
class RunResult:
    """A finished run, as ``hil.run`` returns it, or ``hil.load`` from a recording. ``print`` shows how it went.

    Attributes:
        scenario: what was run; None for a recording that does not hold it.
        metrics: the figures, as ``hil run --json`` prints them; one that is not defined is None, with a sentence in
            ``reasons``. Those of a recording also have what only ``hil review --json`` prints.
        signals: every signal of the run by name, each of shape (ticks,): those of ``hil list signals``, then the extra
            ones. Empty when the run kept none.
        failure: what ended the run early, or None.
        events: the event log, in the order in which it was written.
        notes: sentences on what is missing in a recording, or could not be read; empty for a run.
    """

    scenario: Scenario | None
    metrics: Mapping[str, Any]
    signals: Signals
    failure: HilError | None
    events: Sequence[Event] = ()
    notes: Sequence[str] = ()

    def __repr__(self) -> str:
        shown = [f"{verdict_word(self.metrics)} {self.metrics['scenario']}", f"{self.metrics['ticks']} ticks"]
        if not self.passed and (reasons := [why for _, why in why_not_passed(self.metrics)]):
            more = f" and {len(reasons) - 1} more" if len(reasons) > 1 else ""
            shown.append(textwrap.shorten(reasons[0], _REASON_LETTERS, placeholder=" …") + more)
        return f"<RunResult {', '.join(shown)}>"

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def lines(self, *, everything: bool = False) -> Iterator[str]:
        """Yield how the run went, as ``hil run`` and ``hil review`` print it; ``everything`` as ``--all`` of these."""
        return run_lines(self._told(), everything=everything)

    def _repr_html_(self) -> str:
        """Return the result as a small page, which a notebook shows."""
        from hil.review.notebook import small_page

        return small_page(self._told(), self.signals)

    def _told(self) -> dict[str, Any]:
        """Return the figures with the events and notes."""
        return {**self.metrics, "events": [event._asdict() for event in self.events], "notes": self.notes}

    @property
    def passed(self) -> bool:
        """Whether the run ended as expected."""
        return bool(self.metrics["passed"])

    @property
    def exit_code(self) -> int:
        """0 passed; 1 did not pass; else that of the failure: 2 for the law, 3 for link or device, 130 interrupted."""
        if self.failure is not None:
            return self.failure.exit_code
        return 0 if self.passed else 1

    @cached_property
    def _frame(self) -> "pd.DataFrame":
        need("plots", "a table of pandas")
        import pandas as pd

        return pd.DataFrame(dict(self.signals)).set_index("loop.t_s", drop=False)

    def frame(self) -> "pd.DataFrame":
        """Return the signals as a pandas frame, one row a tick, indexed by ``loop.t_s``."""
        return self._frame
