"""Clocks of the tests' own."""


class StandingClock:
    """In the place of the module ``time``: a monotonic clock that stands still until it is set."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s
