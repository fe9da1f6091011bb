"""The law of a scenario, and the signals that it adds to the run."""

from pathlib import Path
from typing import NamedTuple, cast

from hil.core.ports import Controller, OwnSignals
from hil.core.signals import SIGNAL_NAMES
from hil.laws.law_registry import make_controller
from hil.scenario.tables import Tables


class Laws(NamedTuple):
    """The law that drives the robot."""

    controller: Controller

    @property
    def extra(self) -> tuple[OwnSignals, ...]:
        """The objects whose signals follow the built-in ones in a row, in that order."""
        return (cast(OwnSignals, self.controller),) if getattr(self.controller, "signals", ()) else ()

    @property
    def signals_may_fail(self) -> bool:
        """Whether the law is a third party's with gains or signals of its own, because reading them may fail."""
        return getattr(self.controller, "signals_may_fail", False)

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the run's signals: the built-in ones, then those of the law."""
        return SIGNAL_NAMES + tuple(name for own in self.extra for name in own.signals)


def make_laws(tables: Tables, directory: Path) -> Laws:
    """Return the laws; relative paths start from ``directory``. Raises BadInputError as ``make_controller``."""
    table = tables.controller
    return Laws(make_controller(table.law, directory, tables.robot, table.mode, table.gains))
