"""The environment of a Python process of ours that uses rerun."""

import sys

from hil.core.subprocesses import child_environment

WITH_RERUN = "rerun"
"""An argument of the recorder: import rerun before there is a config."""


def rerun_environment() -> dict[str, str]:
    """Return an environment that finds our packages and lacks the user's settings for rerun.

    RERUN=0, for one, would leave a recording empty.
    """
    kept = {name: value for name, value in child_environment().items() if not name.startswith("RERUN")}
    return kept | {"RUST_LOG": "error"}


class _WithoutPandas:
    @staticmethod
    def find_spec(name: str, _path: object = None, _target: object = None) -> None:
        if name == "pandas":
            raise ModuleNotFoundError("this process needs no pandas", name=name)


def refuse_pandas() -> None:
    """Keep this process, which must be one of our own, from importing pandas, which takes 0.2 s.

    pyarrow imports it where it is installed, only to check whether its arguments are tables.
    """
    sys.meta_path.insert(0, _WithoutPandas)
