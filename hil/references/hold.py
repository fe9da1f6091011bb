"""The reference that stays at one pose."""

from dataclasses import dataclass
from typing import ClassVar

from hil.core.types import Pose, Reference
from hil.references.motion import at_rest


@dataclass(frozen=True, slots=True)
class Hold:
    """A pose to reach and to keep."""

    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0

    ends: ClassVar[bool] = False

    @property
    def span_s(self) -> float:
        """0: nothing changes."""
        return 0.0

    def at(self, t_s: float) -> Reference:
        """Return the pose, at rest."""
        return at_rest(Pose(self.x_m, self.y_m, self.heading_rad))
