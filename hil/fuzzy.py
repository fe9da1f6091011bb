"""The paper's fuzzy tuner: gains K1 and K2 of one axis from its tracking error and the error's rate.

Nguyen Minh et al. 2023, AFDSC, section III.B: five triangular sets an input (table I), singleton outputs
(table II), rules of tables III and IV. The sets overlap so that the memberships of an input add up to 1;
product inference with weighted average is then bilinear interpolation in the table of outputs, and that is
how it is computed.

The paper's text does not give the ranges of the inputs: they are parameters.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Tables = Literal["printed", "corrected"]
Rules = tuple[tuple[str, ...], ...]

K1_1_S = {"VS": 3.0, "S": 5.0, "M": 10.0, "B": 12.0, "VB": 15.0}
K2_1_S = {"VS": 10.0, "S": 15.0, "M": 20.0, "B": 30.0, "VB": 40.0}
"""Table II: output levels [1/s]."""

# Tables III and IV as printed: rows are the error's rate, columns the error, each from NB to PB.
_K1_PRINTED = (
    "M  S  VS S  M",
    "B  M  S  M  B",
    "VS B  M  B  VS",
    "B  M  S  M  B",
    "M  S  VS S  M",
)
_K2_PRINTED = (
    "M  B  VB B  M",
    "S  M  B  M  S",
    "VB S  M  S  VB",
    "S  M  B  M  S",
    "M  B  VB B  M",
)
# Everywhere but at a big error with rate zero, the level of K1 rises with the size of the error and falls
# with that of the rate, and K2's does the opposite. There the print has VS and VB the other way round.
_K1_CORRECTED = (*_K1_PRINTED[:2], "VB B  M  B  VB", *_K1_PRINTED[3:])
_K2_CORRECTED = (*_K2_PRINTED[:2], "VS S  M  S  VS", *_K2_PRINTED[3:])

RULES: dict[Tables, tuple[Rules, Rules]] = {
    "printed": (
        tuple(tuple(row.split()) for row in _K1_PRINTED),
        tuple(tuple(row.split()) for row in _K2_PRINTED),
    ),
    "corrected": (
        tuple(tuple(row.split()) for row in _K1_CORRECTED),
        tuple(tuple(row.split()) for row in _K2_CORRECTED),
    ),
}
"""Rules for K1 and for K2: names of levels, [rate][error]."""


@dataclass(frozen=True, slots=True)
class FuzzyBlock:
    """The tuner of one axis.

    ``error_range`` and ``rate_range`` (in the axis' own units, above zero) are where NB and PB peak; beyond
    them the inputs saturate. The sets in between peak at half the range and at zero.
    """

    error_range: float
    rate_range: float
    k1_1_s: tuple[float, ...]
    """25 outputs for K1, row by row (rate), each row from error NB to PB."""
    k2_1_s: tuple[float, ...]

    @classmethod
    def from_tables(cls, tables: Tables, error_range: float, rate_range: float) -> "FuzzyBlock":
        """Return the block with the paper's tables as printed, or corrected."""
        k1_rules, k2_rules = RULES[tables]
        return cls(
            error_range,
            rate_range,
            tuple(K1_1_S[level] for row in k1_rules for level in row),
            tuple(K2_1_S[level] for row in k2_rules for level in row),
        )

    def gains(self, error: float, rate: float) -> tuple[float, float]:
        """Return (K1, K2) [1/s] at an error and its rate. NaN counts as NB: the gains are always finite."""
        a = 2.0 * error / self.error_range + 2.0
        b = 2.0 * rate / self.rate_range + 2.0
        # The last cell, not the last point: a weight of 1 on its far side gives that point.
        i = 3 if a >= 4.0 else int(a) if a > 0.0 else 0
        j = 3 if b >= 4.0 else int(b) if b > 0.0 else 0
        p = 1.0 if a >= 4.0 else a - i if a > 0.0 else 0.0
        q = 1.0 if b >= 4.0 else b - j if b > 0.0 else 0.0
        n = 5 * j + i
        w00, w01, w10, w11 = (1.0 - q) * (1.0 - p), (1.0 - q) * p, q * (1.0 - p), q * p
        k1, k2 = self.k1_1_s, self.k2_1_s
        return (
            w00 * k1[n] + w01 * k1[n + 1] + w10 * k1[n + 5] + w11 * k1[n + 6],
            w00 * k2[n] + w01 * k2[n + 1] + w10 * k2[n + 5] + w11 * k2[n + 6],
        )

    def gains_batch(
        self, error: "NDArray[np.float64]", rate: "NDArray[np.float64]"
    ) -> "tuple[NDArray[np.float64], NDArray[np.float64]]":
        """Return (K1, K2) [1/s] for arrays that broadcast together: the control surface, for plots."""
        import numpy as np

        a = np.clip(2.0 * np.asarray(error) / self.error_range, -2.0, 2.0) + 2.0
        b = np.clip(2.0 * np.asarray(rate) / self.rate_range, -2.0, 2.0) + 2.0
        i = np.minimum(a.astype(np.intp), 3)
        j = np.minimum(b.astype(np.intp), 3)
        p, q = a - i, b - j
        w00, w01, w10, w11 = (1.0 - q) * (1.0 - p), (1.0 - q) * p, q * (1.0 - p), q * p
        k1, k2 = np.array(self.k1_1_s).reshape(5, 5), np.array(self.k2_1_s).reshape(5, 5)
        return (
            w00 * k1[j, i] + w01 * k1[j, i + 1] + w10 * k1[j + 1, i] + w11 * k1[j + 1, i + 1],
            w00 * k2[j, i] + w01 * k2[j, i + 1] + w10 * k2[j + 1, i] + w11 * k2[j + 1, i + 1],
        )
