"""How many examples a property is tried with.

A profile says it for all, by ``HIL_EXAMPLES`` in the environment. ``quick`` (50 each) is the default; ``usual`` (100)
is what ``tools.mutate`` tries mutants with; ``thorough``, 1000 and others each time, is that of make nightly. A test
whose examples cost more, or find more, than most says what share of them it is to have.
"""

import os
from typing import Any

from hypothesis import settings


def load_profile() -> None:
    """Use the profile of the environment. Raises SystemExit for a name that is none."""
    # No time limit an example: these machines are shared. Whoever changes nothing gets the same examples on every run.
    settings.register_profile("quick", max_examples=50, deadline=None, derandomize=True)
    settings.register_profile("usual", max_examples=100, deadline=None, derandomize=True)
    settings.register_profile("thorough", max_examples=1000, deadline=None, print_blob=True)
    name = os.environ.get("HIL_EXAMPLES", "quick")
    if name not in ("quick", "usual", "thorough"):
        raise SystemExit(f"HIL_EXAMPLES={name}: unknown; expected quick, usual or thorough")
    settings.load_profile(name)


def share_of_examples(share: float, **others: Any) -> settings:
    """Return settings with this share of the profile's examples, and with ``others``; a decorator."""
    return settings(max_examples=max(1, round(share * settings().max_examples)), **others)
