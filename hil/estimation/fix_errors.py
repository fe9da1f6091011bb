"""How the pose of a scan matcher errs: white, lasting, bound to the place, by direction, and wrong for a while.

Sources: A. Censi, An accurate closed-form estimate of ICP's covariance, ICRA 2007 (walls along one direction show
nothing along it); R. G. Brown and P. Y. C. Hwang, Introduction to Random Signals and Applied Kalman Filtering, 2012,
section 3.6 (first-order Gauss-Markov process).
"""

import math
import operator
import random
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

from hil.core.options import Range
from hil.core.types import Axes, Pose, PoseCovariance


@dataclass(frozen=True)
class SimulatedOptions:
    """``[estimator.simulated_fix]``: a lidar's SLAM, simulated from the truth in robot time.

    Raises ValueError for shares of more than 1 in all.
    """

    rate_hz: Annotated[float, Range(ge=0.1, le=1000), "fixes a second"] = 10.0
    latency_s: Annotated[float, Range(ge=0, le=10), "from the scan to the fix"] = 0.1
    sigma_m: Annotated[float, Range(ge=1e-5, le=100), "error of each axis"] = 0.02
    sigma_rad: Annotated[float, Range(ge=1e-5, le=10), "error of the heading"] = 0.01
    noisier: Annotated[float, Range(ge=0.1, le=100), "true error over sigma_m and sigma_rad"] = 1.0
    corridor_times: Annotated[
        float, Range(ge=0.01, le=1000), "error along corridor_rad over sigma_m, which is that across"
    ] = 1.0
    corridor_rad: Annotated[float, "direction of the corridor in the world frame"] = 0.0
    held_share: Annotated[float, Range(ge=0, le=1), "of the variance that lasts for held_s"] = 0.0
    held_s: Annotated[float, Range(ge=0.001, le=86_400), "time constant of the error that lasts"] = 2.0
    map_share: Annotated[float, Range(ge=0, le=1), "of the variance that the place determines: the map is off"] = 0.0
    map_scale_m: Annotated[float, Range(ge=0.01, le=1e6), "side of a square of the map with an error of its own"] = 5.0
    map_blend: Annotated[
        float, Range(ge=0, le=1), "of a square's side over which its error becomes the next one's; 0: at once"
    ] = 1.0
    tells: Annotated[
        Literal["sigmas", "truth"], "covariance sent: of sigma_m and sigma_rad alone, or of its errors but outliers"
    ] = "sigmas"
    outlier_probability: Annotated[float, Range(ge=0, le=1), "of a fix to be wrong"] = 0.0
    outlier_m: Annotated[float, Range(ge=0, le=1000), "how far off; turned by at most as many rad"] = 1.0
    burst_s: Annotated[float, Range(ge=0, le=3600), "for how long wrong fixes agree; 0: each is wrong alone"] = 0.0
    dropout_probability: Annotated[float, Range(ge=0, le=1), "of a fix to be missing"] = 0.0
    gap_start_s: Annotated[float, Range(ge=0, le=86_400), "from here on, since t = 0, there are none"] = 0.0
    gap_end_s: Annotated[float, Range(ge=0, le=86_400), "up to here"] = 0.0

    def __post_init__(self) -> None:
        if self.held_share + self.map_share > 1.0:
            raise ValueError(
                f"held_share = {self.held_share:g} and map_share = {self.map_share:g} are shares of one variance: "
                "expected at most 1 in all"
            )


class Match(NamedTuple):
    """A scan's pose as the matcher has it; ``is_missing`` where it has none."""

    pose: Pose
    is_outlier: bool
    is_missing: bool


class FixErrors:
    """Makes matches of the truth, one after another; one seed gives the same errors.

    The variance of an axis is the same at all times and places, whatever the shares. White noise is the rest of it. The
    lasting part is a first-order Gauss-Markov process over the fixes' own times: the correlation after dt is
    exp(-dt / ``held_s``). The part of the place is one draw for each square of ``map_scale_m``, with edges at whole
    multiples of it, blended near the edges. Each part draws from random numbers of its own, so that an option changes
    its own effect alone.

    ``covariance`` is the one that a fix tells. An outlier does not show in it, as in reality.
    """

    def __init__(self, options: SimulatedOptions, seed: int) -> None:
        self._options = options
        self._seed = seed
        self._random = random.Random(f"pose fixes {seed}")
        self._lasting = _Lasting(random.Random(f"lasting errors of pose fixes {seed}"), options.held_s)
        self._squares: dict[tuple[int, int], Axes] = {}
        self._white_root = math.sqrt(1.0 - options.held_share - options.map_share)
        times = options.noisier if options.tells == "truth" else 1.0
        position, heading = (times * options.sigma_m) ** 2, (times * options.sigma_rad) ** 2
        more = position * (options.corridor_times**2 - 1.0) if options.tells == "truth" else 0.0
        c, s = self._corridor = math.cos(options.corridor_rad), math.sin(options.corridor_rad)
        self.covariance = PoseCovariance(
            position + more * c * c, more * c * s, 0.0, position + more * s * s, 0.0, heading
        )
        self._burst_fixes = max(1, round(options.burst_s * options.rate_hz))
        self._burst_left = 0
        self._burst: Axes = (0.0, 0.0, 0.0)

    def next(self, truth: Pose, t_s: float) -> Match:
        """Return the match of the next scan, ``t_s`` after t = 0."""
        options, chance = self._options, self._random
        white = [self._white_root * chance.gauss(0.0, 1.0) for _ in range(3)]
        wrong = self._outlier()
        is_missing = chance.random() < options.dropout_probability or options.gap_start_s <= t_s < options.gap_end_s
        parts = [white]
        if options.held_share:
            parts.append([math.sqrt(options.held_share) * unit for unit in self._lasting.at(t_s)])
        if options.map_share:
            parts.append([math.sqrt(options.map_share) * unit for unit in self._of_place(truth.x_m, truth.y_m)])
        x, y, turned = map(sum, zip(*parts, strict=True))
        sigma_m, sigma_rad = options.noisier * options.sigma_m, options.noisier * options.sigma_rad
        c, s = self._corridor
        along = (options.corridor_times - 1.0) * (c * x + s * y)
        off = sigma_m * (x + along * c), sigma_m * (y + along * s), sigma_rad * turned
        if wrong is not None:
            off = off[0] + wrong[0], off[1] + wrong[1], off[2] + wrong[2]
        return Match(Pose(*map(operator.add, truth, off)), wrong is not None, is_missing)

    def _outlier(self) -> Axes | None:
        """Return how far off the next fix is besides its error, if it is an outlier.

        Of bursts of n fixes, each begun with a chance of p / (p + n (1 - p)), the share of outliers is p.
        """
        chance, options = self._random, self._options
        share, length = options.outlier_probability, self._burst_fixes
        begins = chance.random() < (share if length == 1 else share / (share + length * (1.0 - share)))
        direction_rad, turned_rad = chance.uniform(-math.pi, math.pi), chance.uniform(-1.0, 1.0) * options.outlier_m
        if begins and not self._burst_left:
            self._burst_left = length
            off_m = options.outlier_m
            self._burst = off_m * math.cos(direction_rad), off_m * math.sin(direction_rad), turned_rad
        if not self._burst_left:
            return None
        self._burst_left -= 1
        return self._burst

    def _of_place(self, x_m: float, y_m: float) -> Axes:
        """Return the map's error of unit variance at a place."""
        size, blend = self._options.map_scale_m, self._options.map_blend
        columns, rows = _shares(x_m / size, blend), _shares(y_m / size, blend)
        weights = {(i, j): p * q for i, p in columns for j, q in rows}
        norm = math.hypot(*weights.values())
        drawn = [[weight / norm * unit for unit in self._square(*cell)] for cell, weight in weights.items()]
        x, y, turned = map(sum, zip(*drawn, strict=True))
        return x, y, turned

    def _square(self, column: int, row: int) -> Axes:
        units = self._squares.get((column, row))
        if units is None:
            chance = random.Random(f"map of pose fixes {self._seed} {column} {row}")
            units = self._squares[column, row] = (chance.gauss(), chance.gauss(), chance.gauss())
        return units


class _Lasting:
    """Three independent Gauss-Markov processes of unit variance, begun in their steady state."""

    def __init__(self, chance: random.Random, time_constant_s: float) -> None:
        self._random = chance
        self._time_constant_s = time_constant_s
        self._t_s = -math.inf
        self._units: Axes = (0.0, 0.0, 0.0)

    def at(self, t_s: float) -> Axes:
        kept = math.exp(-abs(t_s - self._t_s) / self._time_constant_s)
        fresh = math.sqrt(1.0 - kept * kept)
        x, y, turned = (kept * unit + fresh * self._random.gauss() for unit in self._units)
        self._t_s, self._units = t_s, (x, y, turned)
        return self._units


def _shares(at: float, blend: float) -> list[tuple[int, float]]:
    """Return the squares that determine a place along one axis, and their weights; ``at`` counts squares."""
    own = math.floor(at)
    beyond = at - own - 0.5  # from the square's middle, -0.5 to 0.5
    rest = 0.5 - abs(beyond)
    if rest >= 0.5 * blend:
        return [(own, 1.0)]
    way = 0.5 + rest / blend  # from 0.5 on the edge to 1 where the blend ends
    weight = way * way * (3.0 - 2.0 * way)
    return [(own, weight), (own + (1 if beyond >= 0.0 else -1), 1.0 - weight)]
