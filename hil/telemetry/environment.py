"""Starting a Python process of ours that uses rerun."""

from hil.child import child_environment

WITH_RERUN = "rerun"
"""The recorder's argument with which it imports rerun before it has its config, which will need it."""


def rerun_environment() -> dict[str, str]:
    """Return the environment for it: our packages are found, and the user's settings for rerun do not apply.

    RERUN=0, for one, would leave a recording empty.
    """
    kept = {name: value for name, value in child_environment().items() if not name.startswith("RERUN")}
    return kept | {"RUST_LOG": "error"}
