"""How long to wait before a lost link is opened again."""

_FIRST_NS = 100_000_000
_LONGEST_NS = 2_000_000_000


class BackOff:
    """0.1 s first, and twice as long each time, up to 2 s. ``wait_ns`` is the wait that comes next."""

    def __init__(self) -> None:
        self.wait_ns = _FIRST_NS

    def take_ns(self) -> int:
        """Return the wait that has come; the one after it is longer."""
        wait_ns, self.wait_ns = self.wait_ns, min(2 * self.wait_ns, _LONGEST_NS)
        return wait_ns
