"""A recorded run as a result: what ``hil.run`` returned when it was made."""

from pathlib import Path

from hil.core.errors import error_of
from hil.core.options import OptionsError
from hil.core.signals import SIGNAL_NAMES
from hil.judge.results import Signals
from hil.review.figures import figures, json_object, scenario_of
from hil.review.reader import RecordedRun, read
from hil.review.result import RunResult
from hil.scenario import Scenario, from_values


def load(path: str | Path) -> RunResult:
    """Return the result of a recorded run from its ``.rrd`` or ``.mcap`` file, as ``hil.run`` returned it.

    Signals, figures, events and scenario are those of the run. The figures also have what ``hil review --json`` adds:
    ``made``, ``notes`` and ``events``. Of a run that was killed, ``failure`` and ``notes`` say so, and ``signals`` and
    ``figures`` are those of the rows until then. ``scenario`` is None where the recording does not hold it, or holds
    one of another version that this version does not understand; ``notes`` say so. Its ``path`` is None.

    Raises BadInputError when the file is missing, damaged, or not a recording of a run.
    """
    run = read(Path(path))
    metrics = figures(run)
    scenario, notes = _scenario(run)
    metrics["notes"] = notes = [*metrics["notes"], *notes]
    failure = None if metrics["failure"] is None else error_of(metrics["failure_kind"], metrics["failure"])
    names = [name for name in dict.fromkeys([*SIGNAL_NAMES, *run.held, *run.signals]) if name in run.signals]
    signals = Signals({name: run.signals[name] for name in names})
    return RunResult(scenario, metrics, signals, failure, run.events, notes)


def _scenario(run: RecordedRun) -> tuple[Scenario | None, list[str]]:
    """Return the scenario of a run, and a note if there is none."""
    values, name = scenario_of(run), run.properties.get("scenario_name", "")
    if not values:
        return None, ["the recording does not hold the scenario of its run"]
    try:
        return from_values(name, values, json_object(run, "scenario_sources")), []
    except OptionsError as error:
        problems = "; ".join(problem.sentence for problem in error.problems[:2])
        return None, [f"its scenario is that of another version, and this one does not understand it: {problems}"]
