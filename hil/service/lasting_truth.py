"""A truth for a service, which outlives it."""

from collections.abc import Callable

from hil.core.errors import DeviceError
from hil.core.ports import PoseSource
from hil.core.types import PoseFix


class LastingTruth:
    """A PoseSource that has no fix any more once it was lost, instead of raising; ``lost`` is told why, once.

    It is not looked for again: a virtual robot that was started anew has its truth elsewhere.
    """

    def __init__(self, source: PoseSource, lost: Callable[[str], None]) -> None:
        self._source: PoseSource | None = source
        self._lost = lost

    def poll(self) -> PoseFix | None:
        """Return the newest fix, or None when there is none."""
        if self._source is None:
            return None
        try:
            return self._source.poll()
        except DeviceError as error:
            self.close()
            self._lost(str(error))
            return None

    def close(self) -> None:
        """Release the source."""
        if self._source is not None:
            self._source.close()
            self._source = None
