"""Acceptance filters: a few pairs of identifier and mask that pass a set of identifiers, and little else. Pure."""

from collections.abc import Iterable, Iterator
from itertools import combinations
from typing import NamedTuple

IDENTIFIER_BITS = 11
_ALL = (1 << IDENTIFIER_BITS) - 1


class Filter(NamedTuple):
    """Passes an identifier when it equals ``identifier`` in the bits that are 1 in ``mask``."""

    identifier: int
    mask: int

    def passes(self, identifier: int) -> bool:
        """Return whether a frame with the identifier passes."""
        return not (identifier ^ self.identifier) & self.mask

    def joined(self, other: "Filter") -> "Filter":
        """Return the narrowest filter that passes what either passes."""
        mask = self.mask & other.mask & ~(self.identifier ^ other.identifier)
        return Filter(self.identifier & mask, mask)

    @property
    def width(self) -> int:
        """How many identifiers pass."""
        return 1 << (IDENTIFIER_BITS - self.mask.bit_count())


def filters_for(identifiers: Iterable[int], most: int) -> list[Filter]:
    """Return at most ``most`` filters that pass all of these identifiers of 11 bits.

    From one exact filter for each, the two whose union passes the fewest others are joined until there are few enough,
    and further while a union costs nothing.
    """
    filters = [Filter(identifier, _ALL) for identifier in sorted(set(identifiers))]
    while len(filters) > 1:
        cost, one, other = min(_unions(filters))
        if cost > 0 and len(filters) <= most:
            break
        union = one.joined(other)
        filters = sorted([union] + [f for f in filters if f.joined(union) != union])
    return filters


def _unions(filters: list[Filter]) -> Iterator[tuple[int, Filter, Filter]]:
    for one, other in combinations(filters, 2):
        yield one.joined(other).width - one.width - other.width, one, other
