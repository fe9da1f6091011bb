"""A solver for FMUs for model exchange: FMPy's CVode between the events, as FMPy's simulate_fmu handles them.

Between two ticks the FMU is in event mode (FMI 2.0 section 3.2, FMI 3.0 section 3.2): the shim sets the torques there,
which jump from tick to tick, and reads the outputs.
"""

import math
from collections.abc import Callable
from typing import Any

from hil.core.clock import TICK_NS
from hil.core.errors import BadInputError

_RELATIVE_TOLERANCE = 1e-10
_MOST_EVENTS = 1000  # within one tick


class Solver:
    """Integrates an initialised FMU, FMPy's FMU2Model or FMU3Model, from event to event.

    Raises BadInputError when FMPy has no CVode for this platform.
    """

    def __init__(self, fmu: Any, description: Any, version: int) -> None:
        try:
            from fmpy.sundials import CVodeSolver
        except (ImportError, OSError) as error:
            raise BadInputError(
                f"FMPy has no solver for this platform ({error}); export the FMU for co-simulation"
            ) from error
        self._fmu = fmu
        self._update = fmu.newDiscreteStates if version == 2 else fmu.updateDiscreteStates
        interface = description.modelExchange
        self._completes_steps = bool(interface.needsCompletedIntegratorStep)
        self._next_event_s = math.inf
        self._failure: Exception | None = None
        if version == 2:
            states, indicators = description.numberOfContinuousStates, description.numberOfEventIndicators
        else:
            states, indicators = fmu.getNumberOfContinuousStates(), fmu.getNumberOfEventIndicators()
        self._cvode = CVodeSolver(
            nx=states,
            nz=indicators,
            get_x=self._kept(fmu.getContinuousStates),
            set_x=self._kept(fmu.setContinuousStates),
            get_dx=self._kept(fmu.getDerivatives if version == 2 else fmu.getContinuousStateDerivatives),
            get_z=self._kept(fmu.getEventIndicators),
            get_nominals=self._kept(fmu.getNominalsOfContinuousStates),
            set_time=self._kept(fmu.setTime),
            input=self,
            startTime=0.0,
            maxStep=TICK_NS / 1e9,
            relativeTolerance=_RELATIVE_TOLERANCE,
        )
        self._raise_what_was_kept()

    def apply(self, time_s: float) -> None:
        """Hold the inputs: FMPy's CVode asks for them at every evaluation."""

    def step(self, from_s: float, to_s: float) -> None:
        """Integrate from one communication point to the next.

        Raises FMPy's FMICallException when the FMU refuses a call, and RuntimeError with a sentence when CVode fails,
        when the FMU asks to end, and when events do not cease.
        """
        self._handle_event(from_s)
        now_s = from_s
        for _ in range(_MOST_EVENTS):
            until_s = min(to_s, self._next_event_s)
            is_event = False
            if until_s - now_s > 1e-12 * max(1.0, now_s):  # CVode takes no step that is lost in rounding
                try:
                    is_event, _, now_s = self._cvode.step(now_s, until_s)
                finally:  # a call that the FMU refused is the cause of CVode's failure
                    self._raise_what_was_kept()
            else:
                now_s = until_s
            self._fmu.setTime(now_s)
            if self._completes_steps:
                is_step_event, terminates = self._fmu.completedIntegratorStep()
                is_event = is_event or is_step_event
                _go_on_unless(terminates)
            if now_s >= to_s:
                self._fmu.enterEventMode()
                return
            if is_event or now_s >= self._next_event_s:
                self._fmu.enterEventMode()
                self._handle_event(now_s)
        raise RuntimeError(f"the FMU had {_MOST_EVENTS} events within one tick")

    def _handle_event(self, time_s: float) -> None:
        """Leave event mode when the discrete states have settled, and restart the integration."""
        needs_update = True
        while needs_update:
            needs_update, terminates, _, _, is_next_defined, next_s = self._update()
            _go_on_unless(terminates)
        self._next_event_s = max(next_s, time_s) if is_next_defined else math.inf
        self._fmu.enterContinuousTimeMode()
        self._cvode.reset(time_s)
        self._raise_what_was_kept()

    def _kept(self, call: Callable[..., object]) -> Callable[..., None]:
        """Keep what a call raises: CVode calls it from C, through which no exception passes."""

        def keeping(*arguments: object) -> None:
            try:
                call(*arguments)
            except Exception as error:  # noqa: BLE001 - raised again once CVode has returned
                self._failure = self._failure or error

        return keeping

    def _raise_what_was_kept(self) -> None:
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure


def _go_on_unless(terminates: bool) -> None:
    if terminates:
        raise RuntimeError("the FMU asked to end the simulation")
