"""What drivers of four controllers, each with an id of its own, have in common."""

from collections.abc import Iterable, Sequence


def check_ids(name: str, ids: Sequence[int], low: int, high: int) -> None:
    """Raise ValueError unless there are four different ids within a range; for a ``__post_init__``."""
    if len(ids) != 4 or len(set(ids)) != 4 or not all(low <= number <= high for number in ids):
        raise ValueError(f"{name} = {list(ids)}: expected four different ones, each {low} to {high}")


def chosen(ids: Iterable[int], flags: Iterable[bool | None]) -> str:
    """Return the ids whose flag is set, in words; empty when none is."""
    return ", ".join(str(number) for number, flag in zip(ids, flags, strict=True) if flag)


def oldest(stamps: Iterable[int | None]) -> int | None:
    """Return the oldest of the channels' stamps, None while one of them has none."""
    found = None
    for stamp in stamps:
        if stamp is None:
            return None
        found = stamp if found is None else min(found, stamp)
    return found
