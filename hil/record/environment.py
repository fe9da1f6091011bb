"""The environment of our child processes that use rerun, and a guard against a slow import."""

import sys

from hil.core.subprocesses import child_environment

WITH_RERUN = "rerun"
"""Argument of the recorder process: import rerun at once, before the config comes."""


def rerun_environment() -> dict[str, str]:
    """Return environment variables with which a child finds our packages, without the user's settings for rerun.

    A setting such as RERUN=0 would leave a recording empty.
    """
    kept = {name: value for name, value in child_environment().items() if not name.startswith("RERUN")}
    return kept | {"RUST_LOG": "error"}


class _WithoutPandas:
    @staticmethod
    def find_spec(name: str, _path: object = None, _target: object = None) -> None:
        if name == "pandas":
            raise ModuleNotFoundError("this process needs no pandas", name=name)


def refuse_pandas() -> None:
    """Make every import of pandas fail in this process, which saves 0.2 s. Call it only in our own child processes.

    pyarrow imports pandas, where it is installed, only to check whether its arguments are pandas tables.
    """
    sys.meta_path.insert(0, _WithoutPandas)
