"""How many examples a property is tried with, and which.

A profile says it for all, by ``HIL_EXAMPLES`` in the environment. ``quick`` (50 each) is the default; ``usual`` (100)
is what ``tools.mutate`` tries mutants with; ``thorough``, 1000 and others each time, is that of make nightly. A test
whose examples cost more, or find more, than most says what share of them it is to have.

Whoever changes nothing gets the same examples on every run, unless ``HIL_SEED`` is a number: CI takes that of the
commit, and make nightly the date. A failure names it. ``HIL_ORDER=shuffled`` runs files, and the tests of each, in an
order by that number.
"""

import os
import random
from typing import Any

from hypothesis import core, settings


def load_profile() -> None:
    """Use the profile of the environment. Raises SystemExit for a name that is none."""
    # No time limit an example: these machines are shared.
    core.global_force_seed = seed()
    same = seed() is None
    settings.register_profile("quick", max_examples=50, deadline=None, derandomize=same)
    settings.register_profile("usual", max_examples=100, deadline=None, derandomize=same)
    settings.register_profile("thorough", max_examples=1000, deadline=None, print_blob=True)
    name = os.environ.get("HIL_EXAMPLES", "quick")
    if name not in ("quick", "usual", "thorough"):
        raise SystemExit(f"HIL_EXAMPLES={name}: unknown; expected quick, usual or thorough")
    settings.load_profile(name)


def seed() -> int | None:
    """Return the number in ``HIL_SEED``, or None."""
    return int(os.environ["HIL_SEED"]) if os.environ.get("HIL_SEED") else None


def chance() -> random.Random:
    """Return random numbers by the seed, for a property without hypothesis."""
    return random.Random(seed() or 0)


def examples(share: float = 1) -> int:
    """Return how many examples the profile gives, times a share."""
    return max(1, round(share * settings().max_examples))


def share_of_examples(share: float, **others: Any) -> settings:
    """Return settings with this share of the profile's examples, and with ``others``; a decorator."""
    return settings(max_examples=examples(share), **others)
