"""The laws of a scenario: the one in command and its shadows, and which signals the run has because of them."""

from pathlib import Path
from typing import NamedTuple

from hil.core.ports import Controller, OwnSignals
from hil.core.signals import SIGNAL_NAMES
from hil.laws.own_signals import own_signals
from hil.laws.registry import make_controller
from hil.laws.shadows import Shadows
from hil.laws.user import UserLaw
from hil.scenario.tables import Tables


class Laws(NamedTuple):
    """``shadows`` is None for a scenario without any."""

    controller: Controller
    shadows: Shadows | None

    @property
    def extra(self) -> tuple[OwnSignals, ...]:
        """The laws whose signals follow those of the vocabulary, in the order of a row."""
        return own_signals(self.controller) + (() if self.shadows is None else (self.shadows,))

    @property
    def extra_may_fail(self) -> bool:
        """Whether a law that is not shipped has signals, which may fail when they are read."""
        return any(isinstance(own, UserLaw) for own in self.extra)

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the run's signals: the vocabulary, then the extra ones."""
        return SIGNAL_NAMES + tuple(name for own in self.extra for name in own.signals)


def make_laws(tables: Tables, directory: Path) -> Laws:
    """Return the laws; relative paths start from ``directory``. Raises BadInputError as ``make_controller``."""
    table = tables.controller
    model = tables.robot
    controller = make_controller(table.law, directory, model, table.mode, table.gains)
    if not table.shadow:
        return Laws(controller, None)
    shadows = {
        name: make_controller(
            spec,
            directory,
            model,
            table.mode,
            table.shadow_gains.get(name, {}),
            law_key=f"controller.shadow.{index}",
            gains_key=f"controller.shadow_gains.{name}",
        )
        for index, (name, spec) in enumerate(zip(table.shadow_names, table.shadow, strict=True))
    }
    return Laws(controller, Shadows(shadows, table.mode, model))
