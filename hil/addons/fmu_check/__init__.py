"""``hil fmu``: builds, shows and checks FMUs.

``check.py`` checks the archive and runs a co-simulation FMU of FMI 2.0 or 3.0 in a child process,
``python -m hil.addons.fmu_check FOLDER``, in which ``slave.py`` has the FMU. To add a part of the check: a function in
``parts.py``, and its place in ``PARTS``.
"""

from dataclasses import dataclass
from enum import StrEnum
from functools import partial

from hil.core.extensions import Command


class Kind(StrEnum):
    """What a finding means for the FMU. Only a violation fails it."""

    VIOLATION = "violation"  # the standard demands otherwise
    NEED = "need"  # the standard allows it, but a run of this importer ends with it, or steps the FMU otherwise
    NOTE = "note"  # a choice of this importer, which costs the FMU nothing that it declares


@dataclass(frozen=True)
class Finding:
    """One finding, as a sentence."""

    kind: Kind
    text: str


violation, need, note = (partial(Finding, kind) for kind in Kind)

COMMANDS = {
    "fmu": Command(
        "Tools",
        "hil.addons.fmu_check.fmu_command:app",
        "The plant: build, look at and check FMUs.",
    ),
}
