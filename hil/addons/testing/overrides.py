"""Changes to scenarios, by the options of a pytest run and by the arguments of a test."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

from hil.core.printable import command
from hil.scenario import Scenario, load, set_texts


@dataclass(frozen=True)
class Overrides:
    """Changes to a scenario, like the options of ``hil run``; None keeps the scenario's value.

    Attributes:
        set: texts ``key=value``; later ones win.
        mode: ``lockstep`` or ``realtime``.
        link: URL of the link.
        seed: of everything random in the run.
        truth: URL of the truth socket of a robot in another process.
    """

    set: tuple[str, ...] = ()
    mode: str | None = None
    link: str | None = None
    seed: int | None = None
    truth: str | None = None

    def changed(
        self,
        set: Mapping[str, object] | Sequence[str] = (),  # noqa: A002 - the name of the option
        **given: str | int | None,
    ) -> Self:
        """Return these overrides with others on top; None changes nothing. Another link drops the truth of this one."""
        changes: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
        if "link" in changes:
            changes.setdefault("truth", None)
        return replace(self, set=(*self.set, *set_texts(set)), **changes)

    def load(self, scenario: str | Path) -> Scenario:
        """Return the scenario with these changes. Raises BadInputError as ``hil.scenario.load`` does."""
        return load(scenario, set=self.set, mode=self.mode, link=self.link, seed=self.seed)

    def command(self, scenario: Scenario) -> str:
        """Return the command that repeats a run of the scenario, for a shell in the current folder."""
        given = (("--mode", self.mode), ("--link", self.link), ("--seed", scenario.loop.seed))
        options = [word for name, value in given if value is not None for word in (name, str(value))]
        options += [word for text in self.set for word in ("--set", text)]
        if self.truth is not None:
            options += ["--truth", self.truth]
        return command("hil", "run", shown(scenario.path or scenario.name), *options)


def shown(path: str | Path) -> str:
    """Return a path relative to the current folder when it is below it, else unchanged."""
    text = str(path)
    return os.path.relpath(text) if Path(text).is_relative_to(Path.cwd()) else text
