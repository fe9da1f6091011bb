"""Chooses the communication step of a co-simulation FMU from its declarations.

The bridge ticks once a millisecond. An FMU with a ``fixedInternalStepSize`` (FMI 3.0) takes multiples of that. One that
does not claim ``canHandleVariableCommunicationStepSize`` is stepped by the ``stepSize`` of its DefaultExperiment, which
is the preferred communication step. One that claims it is stepped by the tick: its preference alone is no need.
"""

import math
from pathlib import Path
from typing import Any, NamedTuple

from hil.core.clock import LONGEST_STEP_S, TICK_NS
from hil.core.errors import BadInputError

_MOST_STEPS = 1000  # in a tick
_ROUNDING = 1e-6  # relative: a step size may have been a number in single precision


class CommunicationStep(NamedTuple):
    """A communication step: a whole number of ticks, or a tick divided by a whole number.

    ``notice`` is a sentence about a step other than the tick, with its latency, or about a preference that is not
    followed; empty otherwise.
    """

    size_ns: int
    notice: str = ""


def communication_step(
    fmu: Path, description: Any, *, wanted_s: float | None = None, tick_ns: int = TICK_NS
) -> CommunicationStep:
    """Return the communication step of an FMU for co-simulation, from FMPy's description of it.

    ``wanted_s`` is ``plant.step_s``. Raises BadInputError with both sizes when there is no step that fits the tick.
    """
    interface, experiment = description.coSimulation, description.defaultExperiment
    fixed_s = _size(fmu, "fixedInternalStepSize", interface.fixedInternalStepSize)
    preferred_s = _size(fmu, "DefaultExperiment stepSize", experiment and experiment.stepSize)
    tick_s = tick_ns / 1e9
    if wanted_s is not None:
        if fixed_s is not None and _times(wanted_s, fixed_s) is None:
            raise BadInputError(
                f"plant.step_s = {wanted_s:g}; FMU {fmu} has a fixedInternalStepSize of {fixed_s:g} s, expected a "
                "whole multiple of that"
            )
        size_s, why = wanted_s, "as plant.step_s says"
    elif fixed_s is not None:
        is_free = _times(tick_s, fixed_s) is not None
        size_s, why = (tick_s if is_free else fixed_s), "for its fixedInternalStepSize"
    elif preferred_s is not None and not interface.canHandleVariableCommunicationStepSize:
        size_s = preferred_s
        why = "the stepSize of its DefaultExperiment, since canHandleVariableCommunicationStepSize is not true"
    else:
        size_s, why = tick_s, ""
    ticks, steps = _times(size_s, tick_s), _times(tick_s, size_s)
    if ticks is None:
        fits = steps is not None and steps <= _MOST_STEPS and tick_ns % steps == 0
    else:
        fits = ticks == 1 or size_s <= LONGEST_STEP_S * (1 + _ROUNDING)
    if not fits:
        raise BadInputError(
            f"FMU {fmu}: its communication step is {size_s:g} s ({why}), and the bridge's tick {tick_s:g} s; expected "
            f"a whole number of ticks up to {LONGEST_STEP_S:g} s, in which no wheel turns by half a turn, or a tick "
            f"divided into at most {_MOST_STEPS} steps of whole nanoseconds: export it so, or set plant.step_s if it "
            "keeps another constant step"
        )
    return CommunicationStep(
        ticks * tick_ns if ticks is not None else tick_ns // (steps or 1),
        _notice(size_s, why, ticks, steps, tick_s) or _ignored(preferred_s, tick_s, wanted_s),
    )


def _notice(size_s: float, why: str, ticks: int | None, steps: int | None, tick_s: float) -> str:
    if ticks is not None and ticks > 1:
        late_ms = (ticks - 1) * tick_s * 1e3
        return (
            f"stepped by {size_s:g} s, {ticks} ticks ({why}): an input acts up to {late_ms:g} ms late, and an output "
            f"is up to {late_ms:g} ms old"
        )
    return f"stepped by {size_s:g} s, {steps} times a tick ({why})" if steps is not None and steps > 1 else ""


def _ignored(preferred_s: float | None, tick_s: float, wanted_s: float | None) -> str:
    if preferred_s is None or _times(preferred_s, tick_s) == 1:
        return ""
    why = ", as plant.step_s says" if wanted_s is not None else ", which it claims to handle"
    return f"stepped by the tick of {tick_s:g} s{why}; its DefaultExperiment prefers {preferred_s:g} s"


def _times(whole_s: float, part_s: float) -> int | None:
    """Return how many times a part is in a whole; None unless that is a whole number."""
    ratio = whole_s / part_s
    times = round(ratio)
    return times if abs(ratio - times) <= _ROUNDING * times else None


def _size(fmu: Path, name: str, declared: object) -> float | None:
    if declared is None:
        return None
    try:
        size_s = float(str(declared))
    except ValueError:
        size_s = math.nan
    if not 0.0 < size_s < math.inf:
        raise BadInputError(f"FMU {fmu}: its {name} is {declared!r}; expected a positive number of seconds")
    return size_s
