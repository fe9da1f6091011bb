"""A row as JSON datagrams, as PlotJuggler's UDP server reads them: nested objects of numbers, ``timestamp`` at the top.

A row is more than a frame of Ethernet holds, and some versions of that server take no more than 2048 bytes of a
datagram: a row is cut, always at the same signals, and each piece stands for itself.
"""

import json
import math
from collections.abc import Iterator, Sequence

MOST_BYTES = 1400
_LONGEST = -1.2345678901234567e-100
"""As many characters as a float can have."""


class DatagramWriter:
    """Cuts rows of these signals into datagrams of at most ``MOST_BYTES``; ``loop.t_s`` must be among the signals.

    Each has ``timestamp``, the scenario's time [s], and ``sequence``, which counts datagrams from 0 so that a receiver
    sees its losses. A signal without a value is null, which PlotJuggler skips.
    """

    def __init__(self, signals: Sequence[str]) -> None:
        self._time = list(signals).index("loop.t_s")
        self._pieces: list[list[tuple[int, tuple[str, ...]]]] = [[]]
        self._sequence = 0
        for index, signal in enumerate(signals):
            place = (index, tuple(signal.split(".")))
            if self._pieces[-1] and len(_encoded(1e9, 10**12, [*self._pieces[-1], place], None)) > MOST_BYTES:
                self._pieces.append([])
            self._pieces[-1].append(place)

    def datagrams(self, row: Sequence[float]) -> Iterator[bytes]:
        """Yield the pieces of one row."""
        for piece in self._pieces:
            yield _encoded(row[self._time], self._sequence, piece, row)
            self._sequence += 1


def _encoded(t_s: float, sequence: int, piece: list[tuple[int, tuple[str, ...]]], row: Sequence[float] | None) -> bytes:
    """Return a datagram; without a row the longest that it can be."""
    tree: dict[str, object] = {"timestamp": t_s, "sequence": sequence}
    for index, (*groups, name) in piece:
        table = tree
        for group in groups:
            below = table.setdefault(group, {})
            assert isinstance(below, dict), f"{group} is a signal and a group"
            table = below
        value = _LONGEST if row is None else row[index]
        table[name] = value if math.isfinite(value) else None
    return json.dumps(tree, separators=(",", ":")).encode()
