"""The result of a run, as ``hil.run`` returns it and ``hil.load`` reads it back."""

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from hil.core.errors import HilError
from hil.core.extras import need
from hil.core.ports import Event
from hil.core.signals import Signals
from hil.judge.judged_run import JudgedRun
from hil.judge.run_json import to_json
from hil.scenario import Scenario

if TYPE_CHECKING:
    import pandas as pd

_REASON_LETTERS = 90


@dataclass(frozen=True, repr=False)
class RunResult:
    """A finished run, as ``hil.run`` returns it, or ``hil.load`` from a recording. ``print`` shows how it went.

    Attributes:
        scenario: the scenario of the run; None for a recording without it.
        run: the run with its figures and its verdict.
        signals: every signal of the run by name, each of shape (ticks,): those of ``hil list signals``, then the extra
            ones. Empty when the run kept none.
        failure: what ended the run early, or None.
    """

    scenario: Scenario | None
    run: JudgedRun
    signals: Signals
    failure: HilError | None

    def __repr__(self) -> str:
        from hil.judge.run_text import verdict_word, why_not_passed

        shown = [f"{verdict_word(self.run)} {self.run.identity.scenario}", f"{self.run.figures['ticks']} ticks"]
        if not self.passed and (reasons := [why for _, why in why_not_passed(self.run)]):
            more = f" and {len(reasons) - 1} more" if len(reasons) > 1 else ""
            shown.append(textwrap.shorten(reasons[0], _REASON_LETTERS, placeholder=" …") + more)
        return f"<RunResult {', '.join(shown)}>"

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def lines(self, *, everything: bool = False) -> Iterator[str]:
        """Yield how the run went, as ``hil run`` and ``hil review`` print it; ``everything`` as ``--all`` of these."""
        from hil.judge.run_text import run_lines  # only for a result that is shown

        return run_lines(self.run, everything=everything)

    @cached_property
    def metrics(self) -> Mapping[str, Any]:
        """The figures, as ``hil run --json`` prints them, or of a recording ``hil review --json``.

        One that is not defined is None, with a sentence in ``reasons``.
        """
        return to_json(self.run)

    @property
    def events(self) -> Sequence[Event]:
        """The event log, in the order in which it was written."""
        return self.run.events

    @property
    def notes(self) -> Sequence[str]:
        """Sentences on what is missing in a recording, or could not be read; empty for a run."""
        return self.run.notes

    @property
    def passed(self) -> bool:
        return self.run.passed

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
