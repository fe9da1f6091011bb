"""Does the runs of a search and keeps their outcomes in a folder, so that one that was stopped goes on where it was.

A search says what is next only when it knows outcomes whole, so each is kept as JSON. A campaign's rows have a column
for each figure and a recording beside them, so it adds them itself.
"""

import contextlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa

from hil.batch.figures import KEY, MACHINE
from hil.batch.job import Outcome
from hil.batch.plan import Plan, run_plan
from hil.batch.pool import LocalPool
from hil.batch.store import Row, Store, read_rows

_JSON = ("figures", "details")
_SCHEMA = pa.schema(
    [(name, pa.string()) for name in (KEY, "outcome", "reason", *_JSON, f"{MACHINE}worker")]
    + [(f"{MACHINE}wall_s", pa.float64())]
)


def run_resumable(
    plan: Plan,
    folder: Path,
    workers: int | None = None,
    *,
    on_outcomes: Callable[[], None] = lambda: None,
    is_stopping: Callable[[], bool] = lambda: False,
) -> None:
    """Do those jobs of a plan on this machine that a folder does not have the outcomes of, and add theirs.

    ``on_outcomes`` is called at least twice a second; ``is_stopping`` is as for ``run_plan``. Raises BadInputError when
    the folder cannot be written to or is in use, LinkError as ``run_plan``.
    """
    with Store(folder, _SCHEMA) as store:
        known = {row[KEY]: _outcome(row) for row in read_rows(folder).to_pylist()}
        new: list[Row] = []
        try:
            with contextlib.closing(run_plan(plan, LocalPool(workers), known=known, is_stopping=is_stopping)) as done:
                for outcomes in done:
                    new += [_row(outcome) for outcome in outcomes if outcome.key not in known]
                    if new and (store.is_rested or not outcomes):
                        rows, new = new, []
                        store.append(rows)
                    on_outcomes()
        finally:
            store.append(new)


def _row(outcome: Outcome) -> dict[str, Any]:
    texts = {name: json.dumps(dict(getattr(outcome, name))) for name in _JSON}
    machine = {f"{MACHINE}wall_s": outcome.wall_s, f"{MACHINE}worker": outcome.worker}
    return {KEY: outcome.key, "outcome": outcome.status, "reason": outcome.reason, **texts, **machine}


def _outcome(row: Mapping[str, Any]) -> Outcome:
    figures, details = (json.loads(row[name]) for name in _JSON)
    wall_s, worker = row[f"{MACHINE}wall_s"], row[f"{MACHINE}worker"]
    return Outcome(row[KEY], row["outcome"], row["reason"], figures, details, wall_s=wall_s, worker=worker)
