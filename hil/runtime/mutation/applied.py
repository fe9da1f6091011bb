"""Applies the mutant of this process to a run: to the robot that is made, to the link, and to the parts of a tick."""

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

from hil.core import mutant
from hil.core.errors import BadInputError, nearest
from hil.core.ports import Link
from hil.plant import archive
from hil.plant.description import start_defaults
from hil.robot.virtual import MakeNode, MakeRobot, VirtualRobot, VirtualStm32
from hil.runtime.mutation import exchange, frames, wrappers
from hil.runtime.mutation.change import Change
from hil.runtime.mutation.mutation import Mutation
from hil.runtime.tick import TickParts
from hil.scenario import Scenario
from hil.scenario.laws import make_laws

MODEL, GAINS = "model", "gains"
_NOT_CHANGES = ("port", "of")


def moved(value: Any, change: Any) -> Any:
    """Return a value after a change: "*1.2" is a factor, "+0.1" and "-0.1" are added, all else replaces it.

    Raises ValueError for a factor or a sum of what is no number.
    """
    if not (isinstance(change, str) and change[:1] in "*+-"):
        return change
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise ValueError(f"{change!r} of {value!r}, which is no number")
    return value * float(change[1:]) if change[0] == "*" else value + float(change)


class Applied(Mutation):
    """What a mutant changes in runs. ``Mutation`` documents the calls."""

    def __init__(self, found: mutant.Mutant) -> None:
        self._mutant = found
        self._wrap = found.wrap
        self._port = str(self._wrap.get("port"))

    @property
    def properties(self) -> dict[str, str]:
        return {"mutant": self._mutant.id, "mutant_sha256": self._mutant.sha256}

    def refuse_motion(self) -> None:
        raise BadInputError(
            f"{mutant.VARIABLE} puts the mutant {self._mutant.id!r} into this process: real motors get no known "
            "defect; unset the variable, or leave --allow-motion out"
        )

    def made_of(self, made_of: VirtualRobot) -> VirtualRobot:
        found, plant = self._mutant, made_of.plant
        if found.start:
            defaults = start_defaults(plant.fmu)
            known = {name: change for name, change in found.start.items() if name in defaults}
            now = {name: moved(plant.start.get(name, defaults[name]), change) for name, change in known.items()}
            plant = plant._replace(start={**plant.start, **now})
        if found.fmu and archive.is_shipped(plant.fmu):
            plant = plant._replace(fmu=Path(found.fmu))
        return made_of._replace(plant=plant)

    def robot(self, make_robot: MakeRobot) -> MakeRobot:
        def make(made_of: VirtualRobot, make_node: MakeNode) -> AbstractContextManager[VirtualStm32]:
            changes = self._port == "plant"
            node = exchange.changed_node(make_node, self._wrap) if changes else make_node
            return make_robot(self.made_of(made_of), node)

        return make

    def link(self, link: Link) -> Link:
        return frames.ChangedLink(link, self._wrap) if self._port == "link" else link

    def parts(self, scenario: Scenario, parts: TickParts) -> TickParts:
        if self._port not in wrappers.PORTS:
            return parts
        of, port = self._wrap["of"], wrappers.PORTS[self._port]
        if self._port == "law" and of in (MODEL, GAINS):
            changed = _with_other_law(scenario, of, _changes(self._wrap))
            return parts._replace(controller=make_laws(changed, scenario.directory).controller)
        part = getattr(parts, port.attribute)
        if part is None:
            return parts
        wrapped = port.wrapper(part, of, Change(port.of[of], _changes(self._wrap)))
        return parts._replace(**{port.attribute: wrapped})


def check_wrap(wrap: Mapping[str, Any]) -> None:
    """Raise ValueError, with what was expected, for a ``wrap`` that cannot be applied."""
    name, of = str(wrap.get("port")), str(wrap.get("of"))
    known: Mapping[str, tuple[str, ...]]
    if name == "link":
        known = dict.fromkeys(frames.WAYS, ())
    elif name == "plant":
        known = {**exchange.DRIVE, **exchange.SENSE}
    elif name in wrappers.PORTS:
        known = {**wrappers.PORTS[name].of, **({MODEL: (), GAINS: ()} if name == "law" else {})}
    else:
        raise ValueError(f"port {name!r}: expected one of {', '.join((*wrappers.PORTS, 'plant', 'link'))}")
    if of not in known:
        raise ValueError(f"of {of!r}: expected one of {', '.join(known)}{nearest(of, known)}")
    if name == "link":
        frames.ChangedLink(None, wrap)  # type: ignore[arg-type]  # only its options are looked at
    elif of not in (MODEL, GAINS):
        Change(known[of], _changes(wrap))


def _changes(wrap: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in wrap.items() if name not in _NOT_CHANGES}


def _with_other_law(scenario: Scenario, of: str, changes: Mapping[str, Any]) -> Scenario:
    """Return the scenario with which the law is made: its model of the robot, or its options, are changed.

    An option that this law does not have is left out.
    """
    if of == MODEL:
        model = scenario.robot
        now = {name: moved(getattr(model, name), change) for name, change in changes.items()}
        return replace(scenario, robot=replace(model, **now))
    from hil.laws.registry import gains_in_force

    table = scenario.controller
    there = gains_in_force(table.law, scenario.directory, table.gains)
    now = {name: moved(there[name], change) for name, change in changes.items() if name in there}
    return replace(scenario, controller=replace(table, gains={**table.gains, **now}))
