"""Motion of a base that nobody here has asked for, such as by the newest command of a host that was killed. Pure."""

from hil.drivers.port import Sample

_MOVES_RAD_S = 0.5  # one encoder count in 10 ms, which is how some makers measure a speed
_LASTS_NS = 500_000_000


class UnaskedMotion:
    """Told the newest sample of a base that was not armed; ``lasts`` when its wheels have turned for half a second."""

    def __init__(self) -> None:
        self._since_ns: int | None = None

    def lasts(self, sample: Sample | None) -> bool:
        """Take a sample; None also stands for a base that may move."""
        if sample is None or max(map(abs, sample.speed_rad_s)) < _MOVES_RAD_S:
            self._since_ns = None
            return False
        if self._since_ns is None:
            self._since_ns = sample.stamp_ns
        return sample.stamp_ns - self._since_ns > _LASTS_NS
