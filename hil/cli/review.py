"""``hil review``."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from hil.cli.options import Force, Json
from hil.cli.output import print_result, say_on_stderr, table
from hil.core.errors import BadInputError
from hil.core.extras import need
from hil.core.outputs import Existing, existing_files


def review(
    recordings: Annotated[list[Path], Argument(metavar="RUN", help="one recording, or two to compare")],
    html: Annotated[Path | None, Option(metavar="FILE.html", help="a page with plots, in one file")] = None,
    overlay: Annotated[Path | None, Option(metavar="FILE.rrd", help="both runs on one time axis, for hil view")] = None,
    export: Annotated[Path | None, Option(metavar="FILE.csv|.parquet|.mcap", help="signals for other tools")] = None,
    trajectory: Annotated[
        Path | None, Option(metavar="FILE.csv", help="write the robot's poses, for reference.kind = 'trajectory'")
    ] = None,
    align: Annotated[
        str,
        Option(metavar="t|motion|EVENT", help="two runs: by time, first motion, or a part of an event's text"),
    ] = "t",
    difference: Annotated[
        list[str] | None,
        Option(metavar="SIGNAL[=TOLERANCE]", help="two runs: a signal to compare, in its unit; by default the errors"),
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
    from hil.review import changes, differences, read, write_trajectory
    from hil.review.alignment import aligned, asked_for, signals_for
    from hil.review.figures import figures, read_for_figures
    from hil.review.pair import pair_lines

    existing = existing_files(force=force)
    asked = asked_for(difference or [])
    if len(recordings) == 1 and (asked or align != "t"):
        raise BadInputError("--align and --difference compare two runs; name the other recording too")
    _check(recordings, existing, {"page": html, "overlay": overlay, "export": export, "trajectory": trajectory})
    read_run = read_for_figures
    if html is not None:
        need("plots", "--html")
        from hil.review.html_page import write_document
        from hil.review.page import page
        from hil.review.panels import read_for_page

        read_run = read_for_page
    more = signals_for(asked) if len(recordings) == 2 else ()
    runs = [read(path) if export else read_run(path, more) for path in recordings]
    together = aligned(runs, align, asked) if len(runs) == 2 else None
    found = [figures(run) for run in runs]
    if html is not None:
        write_document(html, page(runs, found, together), existing)
    if trajectory is not None:
        write_trajectory(runs[0], trajectory, existing)
    if overlay is not None:
        from hil.review.overlay import write_overlay

        write_overlay(runs[0].path, runs[1].path, overlay, existing)
    if export is not None:
        from hil.review.export import write_export

        write_export(runs[0], export, existing)
    for file in (html, trajectory, overlay, export):
        if file is not None:
            say_on_stderr(f"hil: {file} is written")
    if together is None:
        print_result(as_json, found[0], _one(found[0], everything=everything))
        return
    different, changed = differences(*found), changes(*runs)
    both: dict[str, Any] = {"runs": found, "differences": [row._asdict() for row in different]}
    both["aligned"] = together.figures()
    both["changes"] = [change._asdict() for change in changed]
    lines = ["", *table(together.rows())] if asked or align != "t" else []
    print_result(as_json, both, itertools.chain(pair_lines(found, different, changed, everything=everything), lines))


def _check(recordings: Sequence[Path], existing: Existing, files: Mapping[str, Path | None]) -> None:
    """Raise BadInputError for options that do not fit together and for files that cannot be written.

    ``files`` are the files to write by kind, None for those not wanted.
    """
    from hil.record.files import check_output_path

    if len(recordings) > 2:
        raise BadInputError(f"{len(recordings)} recordings were given; hil review takes one, or two to compare")
    if (overlay := files["overlay"]) is not None and len(recordings) == 1:
        raise BadInputError(f"--overlay {overlay}: an overlay needs two runs; name the other recording too")
    for what in ("export", "trajectory"):
        if files[what] is not None and len(recordings) == 2:
            raise BadInputError(f"--{what} {files[what]}: it is for one run; name one recording")
    for what, file in ((what, file) for what, file in files.items() if file is not None):
        if any(file.exists() and recording.exists() and file.samefile(recording) for recording in recordings):
            raise BadInputError(f"{what} {file}: this is one of the reviewed recordings; choose another name")
        check_output_path(what, file, existing)


def _one(found: Mapping[str, Any], *, everything: bool) -> Iterator[str]:
    """Yield how the run went, then when and by which version it was made."""
    from hil.judge.verdict import row_lines, run_lines

    yield from run_lines(found, everything=everything)
    yield from row_lines(_made(found))


def _made(found: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield when the run was made, and by which version."""
    made = found["made"]
    by = [f"{name} {made[key]}" for name, key in (("version", "mecanum_hil"), ("commit", "commit")) if key in made]
    if "started" in made:
        yield "made", f"{made['started']}, {' '.join(by)}"
