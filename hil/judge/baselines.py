"""A run against its scenario's baseline, and a baseline from runs. No side effects."""

from collections.abc import Mapping, Sequence

from hil.judge.expectations import figures_by_key
from hil.judge.judged_run import BaselineResult, FramesResult, JudgedRun, MovedFigure
from hil.judge.measure import NO_TRUTH, Figure
from hil.scenario import Scenario
from hil.scenario.baseline import Band, Baseline, asked_sha256, is_asked, this_platform

SPREADS = 3.0
SHARE = 0.02
_DIGITS = 9
_NAMED = 4
_MODES = {"lockstep": "in lockstep", "realtime": "in real time"}


def band_of(figure: Figure, values: Sequence[float], tick_s: float = 0.0) -> Band:
    """Return the band of a figure from its values in runs with different seeds, first that with the scenario's own.

    It is the largest of three times the spread, 2 % of the value, and the figure's resolution. ``tick_s`` is the period
    of the loop where chance matters, else 0.
    """
    value, spread = values[0], max(values) - min(values)
    tick = tick_s * (1e3 if figure.unit == "ms" and figure.scale == 1.0 else 1.0)
    band = max(SPREADS * spread, SHARE * abs(value), figure.resolution, figure.resolution_ticks * tick)
    return Band(*(float(f"{one:.{_DIGITS}g}") for one in (value, spread, band)))


def baseline_figures() -> dict[str, Figure]:
    """Return the figures that a baseline has, by the names that users give them: those of no machine."""
    return {key: figure for key, figure in figures_by_key().items() if not figure.of_machine}


def baseline_of(scenario: Scenario, runs: Mapping[int, JudgedRun]) -> Baseline:
    """Return the baseline of a scenario; ``runs`` has the run of each seed, first the scenario's own.

    A figure that one of the runs lacks is left out. So is a time whose band goes on to the end of the run: a run that
    ends before the event lacks the figure, but is within the band.
    """
    known = baseline_figures()
    values = {key: [run.number(figure.name) for run in runs.values()] for key, figure in known.items()}
    whole = {key: [one for one in row if one is not None] for key, row in values.items() if None not in row}
    is_random = any(max(row) != min(row) for row in whole.values())
    tick_s = 1.0 / scenario.loop.rate_hz if is_random else 0.0
    bands = {key: band_of(known[key], row, tick_s) for key, row in whole.items()}
    figures = {key: band for key, band in bands.items() if not _is_any_time(known[key], band, scenario.loop.duration_s)}
    wire_sha256 = next(iter(runs.values())).wire_sha256 or "" if scenario.loop.mode == "lockstep" else ""
    asked, mode = asked_sha256(scenario), scenario.loop.mode
    return Baseline(scenario.name, asked, mode, this_platform(), tuple(runs), wire_sha256, figures)


def _is_any_time(figure: Figure, band: Band, end_s: float) -> bool:
    return figure.of_end and figure.unit == "s" and band.value + band.band >= end_s


def why_not_judged(scenario: Scenario, baseline: Baseline) -> str | None:
    """Return why runs of a scenario cannot be compared with a baseline, or None if they can."""
    if scenario.loop.mode != baseline.mode:
        return f"it was made {_MODES[baseline.mode]}, and the run is {_MODES[scenario.loop.mode]}"
    if asked_sha256(scenario) == baseline.scenario_sha256:
        return None
    given = [key for key, where in scenario.provenance.items() if where.startswith("--") and is_asked(key)]
    keys = list(dict.fromkeys(key.split(".")[0] if key.startswith("fault.") else key for key in given))
    if keys:
        more = f" and {len(keys) - _NAMED} more" if len(keys) > _NAMED else ""
        return f"the run differs from those that made it, in {', '.join(keys[:_NAMED])}{more}"
    return "its scenario was another one; if the change is meant, accept it with `hil baseline --accept`"


def baseline_words(scenario: Scenario) -> str:
    """Return whether the runs of a scenario are judged against a baseline, in a few words."""
    if (baseline := scenario.baseline) is None:
        return "none; `hil baseline` makes it"
    why = why_not_judged(scenario, baseline)
    return f"{baseline.file}, {len(baseline.figure)} figures" if why is None else f"not judged against it: {why}"


def moved(baseline: Baseline, run: JudgedRun) -> list[MovedFigure]:
    """Return the figures of a run that are outside their bands.

    One that needs the ground truth is left out where the run has none.
    """
    found = []
    known = baseline_figures()
    for key, band in baseline.figure.items():
        if (figure := known.get(key)) is None:
            continue
        value = run.number(figure.name)
        if value is not None and abs(value - band.value) <= band.band:
            continue
        if value is None and (why := run.why_none(figure.name)) == NO_TRUTH:
            continue
        shown, accepted = outside(value, band.value, band.band, 6)
        text = f"{key}: no value ({why})" if value is None else f"{key}: {shown}"
        text += f" in place of {accepted}"
        if value is not None and band.value:
            text += f", {100.0 * (value / band.value - 1.0):+.3g} %"
        found.append(MovedFigure(key, band.value, value, band.band, text))
    return found


def outside(value: float | None, centre: float, band: float, digits: int) -> tuple[str, str]:
    """Return a figure and its band as texts, in ``digits`` digits, or in more if only these show that it is outside."""
    for more in range(17):
        found = "no value" if value is None else f"{value:.{digits + more}g}"
        middle, width = f"{centre:.{digits + more}g}", f"{band:.{digits // 2 + more}g}"
        if value is None or abs(float(found) - float(middle)) > float(width):
            break
    return found, f"{middle} ± {width}"


def against_baseline(scenario: Scenario, run: JudgedRun, *, is_cut: bool) -> BaselineResult | None:
    """Return the outcome of a run against its scenario's baseline; None without a baseline.

    A figure with an expectation relative to the baseline is judged by that expectation. The frames (their
    hash) are judged only on the platform of the baseline and with its first seed.
    """
    baseline = scenario.baseline
    if baseline is None:
        return None
    why = why_not_judged(scenario, baseline)
    if why is None and is_cut:
        why = "the run ended early"
    if why is not None:
        return BaselineResult(baseline.file, why)
    own = {row.figure for row in scenario.expect if row.baseline is not None}
    rows = [one for one in moved(baseline, run) if one.key not in own]
    frames = None
    if baseline.wire_sha256 and scenario.loop.seed == baseline.seeds[0] and run.wire_sha256 is not None:
        frames = _frames(baseline, run.wire_sha256)
    return BaselineResult(baseline.file, None, len(baseline.figure.keys() - own), rows, frames)


def _frames(baseline: Baseline, wire_sha256: str) -> FramesResult:
    """Return whether the frames on the wire were the same; on another platform ``passed`` is None if they were not."""
    if wire_sha256 == baseline.wire_sha256:
        return FramesResult(True, "the frames on the wire are the same")
    here = this_platform()
    hashes = f"wire_sha256 is {wire_sha256[:12]}, not {baseline.wire_sha256[:12]}"
    if here == baseline.platform:
        return FramesResult(False, f"the frames on the wire are others: {hashes}")
    return FramesResult(None, f"{hashes}; not judged: made on {baseline.platform}, and this is {here}")
