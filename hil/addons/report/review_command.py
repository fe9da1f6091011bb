"""``hil review``, and its export of a recording for other programs."""

import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from hil.cli.options import Force, Json
from hil.cli.output import print_result, say_on_stderr, table
from hil.core.errors import BadInputError
from hil.core.extras import need
from hil.core.outputs import Existing, existing_files, whole_file

if TYPE_CHECKING:
    import pyarrow as pa

    from hil.judge.judged_run import JudgedRun
    from hil.record.reader import RecordedRun

_ROWS_AT_ONCE = 50_000


def review(
    recordings: Annotated[list[Path], Argument(metavar="RUN", help="one recording, or two to compare")],
    html: Annotated[Path | None, Option(metavar="FILE.html", help="a page with plots, in one file")] = None,
    export: Annotated[Path | None, Option(metavar="FILE.csv|.parquet", help="signals for other tools")] = None,
    difference: Annotated[
        list[str] | None,
        Option(metavar="SIGNAL", help="two runs: a signal to compare; repeatable; by default the errors"),
    ] = None,
    everything: Annotated[
        bool, Option("--all", help="print what is the same or held too, and the figures of machine and link")
    ] = False,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Report from its recording alone how a run went and why; with two runs, which figures became better or worse.

    The exit code is 0 whenever the recordings could be read, even if a run failed: it is about the review, not the run.
    Whether the run passed is "passed" in the output of --json.
    """
    from hil.addons.report import difference as compared
    from hil.judge.recorded import judged_run, read_for_figures
    from hil.judge.run_json import to_json
    from hil.record.reader import read

    existing = existing_files(force=force)
    asked = difference or []
    if len(recordings) == 1 and asked:
        raise BadInputError("--difference compares two runs; name the other recording too")
    _check(recordings, existing, {"page": html, "export": export})
    read_run = read_for_figures
    if html is not None:
        need("plots", "--html")
        from hil.addons.report.panels import read_for_page
        from hil.addons.report.review_page import page
        from hil.pages.html_page import write_document

        read_run = read_for_page
    more = {*asked, *compared.COMPARED} if len(recordings) == 2 else ()
    runs = [read(path) if export else read_run(path, more) for path in recordings]
    signals = compared.signal_differences(runs[0], runs[1], asked) if len(runs) == 2 else []
    found = [judged_run(run) for run in runs]
    if html is not None:
        write_document(html, page(runs, found, signals), existing)
    if export is not None:
        write_export(runs[0], export, existing)
    for file in (html, export):
        if file is not None:
            say_on_stderr(f"hil: {file} is written")
    if len(runs) == 1:
        print_result(as_json, to_json(found[0]), _one(found[0], everything=everything))
        return
    different, changed = compared.differences(*found), compared.changes(*runs)
    both: dict[str, Any] = {"runs": [to_json(one) for one in found]}
    both["differences"] = [row._asdict() for row in different]
    both["signals"] = [one.figures() for one in signals]
    both["changes"] = [change._asdict() for change in changed]
    text = compared.pair_lines(found, different, changed, everything=everything)
    lines = ["", *table(compared.signal_rows(signals))] if asked else []
    print_result(as_json, both, itertools.chain(text, lines))


def _check(recordings: Sequence[Path], existing: Existing, files: Mapping[str, Path | None]) -> None:
    """Raise BadInputError for options that do not fit together and for files that cannot be written.

    ``files`` are the files to write by kind, None for those not wanted.
    """
    from hil.record.files import check_output_path

    if len(recordings) > 2:
        raise BadInputError(f"{len(recordings)} recordings were given; hil review takes one, or two to compare")
    if files["export"] is not None and len(recordings) == 2:
        raise BadInputError(f"--export {files['export']}: it is for one run; name one recording")
    for what, file in ((what, file) for what, file in files.items() if file is not None):
        if any(file.exists() and recording.exists() and file.samefile(recording) for recording in recordings):
            raise BadInputError(f"{what} {file}: this is one of the reviewed recordings; choose another name")
        check_output_path(what, file, existing)


def _one(found: "JudgedRun", *, everything: bool) -> Iterator[str]:
    """Yield how the run went, then when and by which version it was made."""
    from hil.judge.run_text import row_lines, run_lines

    yield from run_lines(found, everything=everything)
    made = found.made or {}
    by = [f"{name} {made[key]}" for name, key in (("version", "mecanum_hil"), ("commit", "commit")) if key in made]
    if "started" in made:
        yield from row_lines(iter([("made", f"{made['started']}, {' '.join(by)}")]))


def write_export(run: "RecordedRun", file: Path, existing: Existing = "refuse") -> None:
    """Write all signals of a run, which must have been read whole, for other programs: as CSV or Parquet.

    Columns have the names of ``hil list signals``. A missing value is an empty cell in CSV, and a null in Parquet.
    Raises BadInputError when the file cannot be written, and when pyarrow is not installed.
    """
    try:
        with whole_file(file, "export", existing) as unfinished:
            _write(run, unfinished)
    except ImportError as error:
        raise BadInputError(f"export {file}: no library to write {file.suffix} ({error}); install pyarrow") from error
    except OSError as error:
        raise BadInputError(f"export {file}: it cannot be written ({error.strerror or error})") from error


def _write(run: "RecordedRun", file: Path) -> None:
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
            for start in range(0, len(run.signals["loop.t_s"]), _ROWS_AT_ONCE):
                rows = slice(start, start + _ROWS_AT_ONCE)  # with from_pandas NaN becomes null
                columns = [pa.array(values[rows], from_pandas=True) for values in run.signals.values()]
                writer.write_batch(pa.record_batch(columns, schema=schema))


def _schema(run: "RecordedRun") -> "pa.Schema":
    """Return the columns with unit and meaning, and the run's properties, events and summary."""
    import pyarrow as pa

    from hil.core.signals import SIGNALS, unit_of

    meanings = {signal.name: signal.meaning for signal in SIGNALS}
    fields = [
        pa.field(name, pa.float64(), metadata={"unit": unit_of(name), "meaning": meanings.get(name, "")})
        for name in run.signals
    ]
    about = {**run.properties, "events": json.dumps([event._asdict() for event in run.events])}
    if run.summary is not None:
        about["summary"] = json.dumps(run.summary)
    return pa.schema(fields, metadata=about)
