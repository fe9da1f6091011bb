"""How far many runs are, on stderr: one line that is written over."""

import sys
from collections.abc import Callable
from typing import TypeVar

A = TypeVar("A")


def runs_progress(trouble: Callable[[A], str | None]) -> Callable[[int, int, A], None]:
    """Return what to call with how many runs are done, of how many, and what became of the newest.

    ``trouble`` is a sentence about one that is not as it should be, which stays to be read; None for any other.
    """

    def tell(done: int, of: int, newest: A) -> None:
        if (sentence := trouble(newest)) is not None:
            print(f"\r{sentence}", file=sys.stderr)
        print(f"\r{done} of {of} runs", end="\n" if done == of else "", file=sys.stderr, flush=True)

    return tell
