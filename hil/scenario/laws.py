"""The laws of a scenario: the one that drives the robot and its shadows, and the signals that they add to the run."""

from pathlib import Path
from typing import NamedTuple, cast

from hil.core.ports import Controller, OwnSignals
from hil.core.signals import SIGNAL_NAMES
from hil.laws.registry import make_controller
from hil.laws.shadows import Shadows
from hil.laws.user import UserLaw
from hil.scenario.tables import Tables


class Laws(NamedTuple):
    """The law that drives the robot, and its shadows; None for a scenario without any."""

    controller: Controller
    shadows: Shadows | None

    @property
    def extra(self) -> tuple[OwnSignals, ...]:
        """The objects whose signals follow the built-in ones in a row, in that order."""
        own = (cast(OwnSignals, self.controller),) if getattr(self.controller, "signals", ()) else ()
        return own if self.shadows is None else (*own, self.shadows)

    @property
    def signals_may_fail(self) -> bool:
        """Whether the law is a third party's with gains or signals of its own, because reading them may fail."""
        law = self.controller
        return isinstance(law, UserLaw) and (law.has_gains or bool(law.signals))

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the run's signals: the built-in ones, then those of the laws."""
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
        for index, (name, spec) in enumerate(zip(table.shadow_names, table.shadow, strict=True), start=1)
    }
    return Laws(controller, Shadows(shadows, table.mode, model))
