"""The mutant of this process, as a run sees it. Without one nothing changes, and no more is imported."""

import functools
from typing import TYPE_CHECKING

from hil.core import mutant

if TYPE_CHECKING:
    from hil.core.ports import Link
    from hil.robot.virtual import MakeRobot, VirtualRobot
    from hil.runtime.tick import TickParts
    from hil.scenario import Scenario


class Mutation:
    """What the mutant of this process changes in runs: here nothing."""

    @property
    def properties(self) -> dict[str, str]:
        """What a recording and the results of a run say of it: ``mutant``, ``mutant_sha256``; empty without one."""
        return {}

    def refuse_motion(self) -> None:
        """Raise BadInputError where real motors would get a known defect."""

    def made_of(self, made_of: "VirtualRobot") -> "VirtualRobot":
        """Return a robot's configuration with the mutant's start values and FMU; values that an FMU lacks are left."""
        return made_of

    def robot(self, make_robot: "MakeRobot") -> "MakeRobot":
        """Return what makes the mutated robot: another configuration, or a changed exchange with the plant."""
        return make_robot

    def link(self, link: "Link") -> "Link":
        """Return the link, with changed frames if the mutant changes some."""
        return link

    def parts(self, scenario: "Scenario", parts: "TickParts") -> "TickParts":
        """Return the parts of a tick, one of them wrapped if the mutant wraps one."""
        return parts


@functools.cache
def mutation() -> Mutation:
    """Return what the mutant of this process changes."""
    found = mutant.in_force()
    if found is None:
        return Mutation()
    from hil.runtime.mutation.applied import Applied

    return Applied(found)
