"""AFDSC with the paper's tables corrected, for comparison with the printed ones."""

from typing import ClassVar

from hil.laws.afdsc import Afdsc
from hil.laws.fuzzy import Tables


class AfdscCorrected(Afdsc):
    """AFDSC with the paper's tables corrected: at a large steady error the print has VS and VB swapped.

    Everything else, options included, is as in ``Afdsc``.
    """

    tables: ClassVar[Tables] = "corrected"
