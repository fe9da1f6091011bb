"""AFDSC with the paper's tables corrected, so that the two can be compared."""

from typing import ClassVar

from hil.laws.afdsc import Afdsc
from hil.laws.fuzzy import Tables


class AfdscCorrected(Afdsc):
    """AFDSC with the corrected tables: where the print has VS and VB the other way round, at a big steady error.

    All else is AFDSC's, the options too.
    """

    tables: ClassVar[Tables] = "corrected"
