"""What is compared: a law with its gains, as in ``dsc,k1_1_s=8`` or ``./my_law.py:MyLaw,speed.gain=3``."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from hil.core.errors import BadInputError
from hil.core.options import build
from hil.core.types import CommandMode
from hil.laws.registry import SHIPPED, load_law
from hil.scenario import Scenario, format_value, load, shipped
from hil.scenario.toml_text import parse_value

Gains = dict[str, object]


class Entry(NamedTuple):
    """A law with its gains in either mode; ``law`` is as a scenario would have it, ``label`` as the user wrote it.

    ``unsaid`` are those of the gains that are not the law's defaults, and that the label does not name: the scenario's.
    """

    label: str
    law: str
    gains: Mapping[CommandMode, Gains]
    unsaid: Mapping[CommandMode, Gains]

    def title(self, mode: CommandMode) -> str:
        """Return what a table calls it in a mode: nothing by which it differs from the law's defaults is hidden."""
        unsaid = ", ".join(f"{name} = {format_value(value)}" for name, value in self.unsaid[mode].items())
        return f"{self.label} ({unsaid})" if unsaid else self.label


def entries(texts: Sequence[str], scenario: str, sets: Sequence[str]) -> list[Entry]:
    """Return what the texts name.

    A law starts from the gains of the scenario when it is the scenario's own and the mode is the scenario's too, from
    its defaults otherwise; over these come those of the text, for both modes or, behind ``torque.`` or ``speed.``, for
    one. Raises BadInputError for a law that does not exist, for gains that it does not take, and for one named twice.
    """
    named: dict[str, Entry] = {}
    for text in texts:
        if text in named:
            raise BadInputError(f"law {text}: it is named twice; name it once, or with other gains, as in {text},key=1")
        named[text] = _entry(text, scenario, sets)
    return list(named.values())


def _entry(text: str, scenario: str, sets: Sequence[str]) -> Entry:
    law, *assignments = text.split(",")
    given = _given(text, assignments)
    base = load(scenario, set=[*sets, f"controller.law={format_value(law)}"])
    kind = getattr(load_law(base.controller.law, base.directory), "Options", None)
    gains = {mode: _of_scenario(base, mode) | given[mode] for mode in CommandMode}
    for mode in CommandMode:
        if kind is not None:
            build(kind, gains[mode], f"law {law}")
        elif gains[mode]:
            raise BadInputError(f"law {text}: it has no dataclass Options, so it takes no gains; leave them out")
    defaults = {field.name: field.default for field in dataclasses.fields(kind)} if kind is not None else {}
    unsaid = {
        mode: {name: value for name, value in of_mode.items() if name not in given[mode] and value != defaults[name]}
        for mode, of_mode in gains.items()
    }
    return Entry(text, base.controller.law, gains, unsaid)


def _of_scenario(base: Scenario, mode: CommandMode) -> Gains:
    return dict(base.controller.gains) if base.controller.mode is mode else {}


def _given(text: str, assignments: Sequence[str]) -> dict[CommandMode, Gains]:
    given: dict[CommandMode, Gains] = {mode: {} for mode in CommandMode}
    for assignment in assignments:
        key, equals, value = assignment.partition("=")
        scope, dot, name = key.strip().rpartition(".")
        modes = [mode for mode in CommandMode if not dot or mode.name.lower() == scope]
        if not (equals and name and modes):
            raise BadInputError(
                f"law {text}: {assignment!r} is no gain; expected key=value, torque.key=value or speed.key=value, as "
                "in dsc,k1_1_s=8"
            )
        for mode in modes:
            given[mode][name] = parse_value(value.strip())
    return given


def check_is_scenario(name: str) -> None:
    """Raise BadInputError when the last word of a command line is a law: the scenario was forgotten."""
    law = name.partition(",")[0]
    if name not in shipped() and (law in SHIPPED or ":" in law):
        raise BadInputError(
            f"scenario {name}: this is a law; the last argument is the scenario, one of hil list scenarios or a file"
        )
