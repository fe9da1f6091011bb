"""Listed runs whose rows a folder keeps: those that were done are not done again, and ``Judged`` shows them."""

import contextlib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from hil.addons.batch.columns import KEY, MACHINE
from hil.addons.batch.job import Job, Outcome
from hil.addons.batch.pool import Listed, run_plan
from hil.addons.batch.store import ROWS, Row, Store, check_folder, read_rows
from hil.runtime.provenance import versions


class KeptRuns:
    """The runs of a campaign or a comparison.

    ``about`` describes the whole (``store``); ``plan`` has, for each run in order, the key of its job, the columns that
    are known before it is done, and in ``repeat`` the command that repeats it.
    """

    def __init__(self, about: Mapping[str, Any], plan: Sequence[Row]) -> None:
        self.about = {**about, "runs": len(plan), "plan": list(plan)}
        self._columns = {row[KEY]: {name: value for name, value in row.items() if name != "repeat"} for row in plan}

    def perform(
        self,
        folder: Path,
        job: Callable[[str, str], Job],
        workers: int | None = None,
        redo: Collection[str] = (),
    ) -> Iterator[Sequence[Row]]:
        """Do the runs that are still to do, and yield their rows as they come, each when it is on the disk.

        ``job`` makes the job of a key that is recorded to a file. The rows that the folder already has are yielded
        first; those with an outcome in ``redo`` are left out, and their runs are done again. Raises BadInputError when
        the folder cannot be written to or belongs to another campaign.
        """
        check_folder(folder, self.about)
        with Store(folder) as store:
            store.begin(self.about)
            there, commit = self._done(folder, redo), versions().get("commit")
            yield list(there.values())
            jobs = (job(key, store.without_recording(key)) for key in self._columns if key not in there)
            with contextlib.closing(run_plan(Listed(jobs), workers)) as done:
                for outcomes in done:
                    rows = [self._finished(outcome, store, commit) for outcome in outcomes]
                    store.append(rows)
                    yield rows

    def left(self, folder: Path, redo: Collection[str] = ()) -> int:
        """Return how many runs ``perform`` would do in a folder, which need not exist. Raises BadInputError as it."""
        check_folder(folder, self.about)
        return len(self._columns) - (len(self._done(folder, redo)) if (folder / ROWS).exists() else 0)

    def _done(self, folder: Path, redo: Collection[str]) -> dict[str, Row]:
        """Return the rows of these runs that are in a folder, by their keys, but for outcomes in ``redo``."""
        rows = read_rows(folder)
        return {key: row for key, row in rows.items() if key in self._columns and row["outcome"] not in redo}

    def _finished(self, outcome: Outcome, store: Store, commit: str | None) -> Row:
        """Return the row of an outcome; remove the recording of an earlier attempt if this one has none."""
        if outcome.recording is None:
            store.without_recording(outcome.key)
        return {
            "outcome": outcome.status,
            "reason": outcome.reason,
            **outcome.figures,
            **self._columns[outcome.key],
            f"{MACHINE}wall_s": outcome.wall_s,
            f"{MACHINE}commit": commit,
        }
