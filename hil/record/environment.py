"""Starting a Python process of ours that uses rerun."""

import sys

from hil.core.subprocesses import child_environment

WITH_RERUN = "rerun"
"""The recorder's argument with which it imports rerun before it has its config, which will need it."""


def rerun_environment() -> dict[str, str]:
    """Return the environment for it: our packages are found, and the user's settings for rerun do not apply.

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
    """Have this process, which is to be one of ours alone, import no pandas, which takes 0.2 s.

    pyarrow imports it, where there is one, only to ask of what it is given whether it is a table.
    """
    sys.meta_path.insert(0, _WithoutPandas)
