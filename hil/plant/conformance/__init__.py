"""The run-time check of ``hil fmu check``: runs an unpacked co-simulation FMU of FMI 2.0 or 3.0, and reports findings.

``python -m hil.plant.conformance FOLDER`` is the child process of ``hil.plant.tools.check``. ``slave.py`` has the FMU,
of either version. May import: as `hil.plant`. To add a part of the check: a function in ``parts.py``, or in
``misuse.py`` if its calls are illegal, and its place in ``PARTS``.
"""

from dataclasses import dataclass
from enum import StrEnum
from functools import partial


class Kind(StrEnum):
    """What a finding means for the FMU. Only a violation fails it."""

    VIOLATION = "violation"  # the standard demands otherwise
    ADVICE = "advice"  # the importer should not have done this: the standard does not say what the FMU must do then
    NEED = "need"  # the standard allows it, but a run of this importer ends with it, or steps the FMU otherwise
    NOTE = "note"  # a choice of this importer, which costs the FMU nothing that it declares


@dataclass(frozen=True)
class Finding:
    """One finding, as a sentence."""

    kind: Kind
    text: str


violation, advice, need, note = (partial(Finding, kind) for kind in Kind)
