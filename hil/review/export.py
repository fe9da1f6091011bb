"""A recording for other programs: every signal as CSV, Parquet or MCAP, and its poses as a trajectory.

Columns have the names of ``hil list signals``, which end in the unit. A missing value is an empty cell in CSV, a null
in Parquet, and NaN in MCAP.
"""

import csv
import io
import json
import uuid
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hil.core.errors import BadInputError
from hil.core.outputs import Existing, check_free, whole_file, write_whole
from hil.core.signals import SIGNALS, unit_of
from hil.record.files import check_output_path
from hil.review.layouts import layout_files, write_layouts
from hil.review.reader import RecordedRun

if TYPE_CHECKING:
    import pyarrow as pa

_ROWS_AT_ONCE = 50_000


def write_export(run: RecordedRun, file: Path, existing: Existing = "refuse") -> None:
    """Write all signals of a run, and layouts of PlotJuggler and Foxglove beside them; the extension gives the format.

    The run must have been read whole.

    ``existing`` says what to do if the file exists. Raises BadInputError for an unknown extension, when the file cannot
    be written, and when the library that writes the format is not installed.
    """
    check_output_path("export", file, existing)
    for beside in layout_files(file):
        check_free("layout", beside, existing)
    try:
        with whole_file(file, "export", existing) as unfinished:
            (_write_mcap if file.suffix == ".mcap" else _write_table)(run, unfinished)
        write_layouts(run, file, existing)
    except ImportError as error:
        remedy = "install pyarrow, or export to .mcap, which does not need it"
        raise BadInputError(f"export {file}: no library to write {file.suffix} ({error}); {remedy}") from error
    except OSError as error:
        raise BadInputError(f"export {file}: it cannot be written ({error.strerror or error})") from error


def _write_table(run: RecordedRun, file: Path) -> None:
    """Write CSV or Parquet."""
    import pyarrow as pa
    from pyarrow.csv import CSVWriter, WriteOptions
    from pyarrow.parquet import ParquetWriter

    schema = _schema(run)
    with file.open("wb") as output:
        if file.suffix == ".csv":
            # The header is written without quotes: not every program removes them.
            output.write(",".join(run.signals).encode() + b"\n")
            options = WriteOptions(include_header=False, quoting_style="none")
            writer = CSVWriter(output, schema, write_options=options)
        else:
            writer = ParquetWriter(output, schema, compression="zstd")
        with writer:
            for rows in _slices(run):  # with from_pandas NaN becomes null
                columns = [pa.array(values[rows], from_pandas=True) for values in run.signals.values()]
                writer.write_batch(pa.record_batch(columns, schema=schema))


def _write_mcap(run: RecordedRun, file: Path) -> None:
    from hil.record.mcap_file import McapFile

    writer = McapFile(
        file,
        _zero_unix_ns(run),
        signals=list(run.signals),
        properties=run.properties,
        part={"recording_id": str(uuid.uuid4()), "number": 1, "first_row": 0},
    )
    for rows in _slices(run):
        writer.rows(np.column_stack([values[rows] for values in run.signals.values()]))
        writer.flush()
    for event in run.events:
        writer.event(event.t_s, event.severity, event.text)
    if run.rows_dropped is not None:
        written = len(run.signals["loop.t_s"])
        writer.finish(run.summary, {"rows_written": written, "rows_dropped": run.rows_dropped})
    writer.close()


def _schema(run: RecordedRun) -> "pa.Schema":
    """Return the columns with unit and meaning, and the run's properties, events and summary."""
    import pyarrow as pa

    meanings = {signal.name: signal.meaning for signal in SIGNALS}
    fields = [
        pa.field(name, pa.float64(), metadata={"unit": unit_of(name), "meaning": meanings.get(name, "")})
        for name in run.signals
    ]
    about = {**run.properties, "events": json.dumps([event._asdict() for event in run.events])}
    if run.summary is not None:
        about["summary"] = json.dumps(run.summary)
    return pa.schema(fields, metadata=about)


def _slices(run: RecordedRun) -> Iterator[slice]:
    """Yield the rows of a run in slices of ``_ROWS_AT_ONCE``."""
    for start in range(0, len(run.signals["loop.t_s"]), _ROWS_AT_ONCE):
        yield slice(start, start + _ROWS_AT_ONCE)


def _zero_unix_ns(run: RecordedRun) -> int:
    """Return the Unix time [ns] of about t = 0, by the property ``started``; 0 without it."""
    try:
        return int(datetime.fromisoformat(run.properties["started"]).timestamp() * 1e9)
    except (KeyError, ValueError):
        return 0


_POSE = ("x_m", "y_m", "heading_rad")


def write_trajectory(run: RecordedRun, path: Path, existing: Existing = "refuse") -> None:
    """Write time and pose of each tick that has one: the true pose where the run knew it, else the estimate.

    ``existing`` says what to do if the file exists. Raises BadInputError when the recording has no pose, and when the
    file cannot be written.
    """
    check_output_path("trajectory", path, existing)
    signals = run.signals
    for source in ("truth", "pose"):
        names = [f"{source}.{name}" for name in _POSE]
        if all(name in signals for name in names):
            rows = np.stack([signals["loop.t_s"], *(signals[name] for name in names)], axis=1)
            rows = rows[np.isfinite(rows).all(axis=1)]
            if len(rows):
                break
    else:
        raise BadInputError(f"{run.path}: no tick has a pose, which a trajectory needs")
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(("t_s", *_POSE))
    writer.writerows(rows.tolist())
    write_whole(path, text.getvalue().encode(), "trajectory", existing)
