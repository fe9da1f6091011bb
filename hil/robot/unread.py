"""How long what a poll took may have lain on the link: since that was last found empty."""


class Unread:
    """Told by a host that polls in real time; ``ns`` is of the newest poll. Pure."""

    def __init__(self) -> None:
        self._emptied_ns: int | None = None
        self.ns = 0

    def polled(self, now_ns: int, *, everything: bool) -> None:
        """Note a poll, and whether it took all that there was."""
        before_ns = now_ns if self._emptied_ns is None else self._emptied_ns
        self._emptied_ns = now_ns if everything else before_ns
        self.ns = now_ns - before_ns

    def forget(self) -> None:
        """Begin anew: what the link held was discarded."""
        self._emptied_ns = None
