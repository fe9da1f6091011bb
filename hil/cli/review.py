"""``hil review``."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from hil.cli.options import Force, Json
from hil.cli.output import print_result, rows, table
from hil.core.errors import BadInputError
from hil.core.outputs import Existing, existing_files

if TYPE_CHECKING:
    from hil.review import Change, Difference

_EVENTS_SHOWN = 8
_CHANGES_SHOWN = 20
_LONGEST_VALUE = 44


def review(
    recordings: Annotated[list[Path], Argument(metavar="RUN [OTHER]", help="one recording, or two to compare")],
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

    existing = existing_files(force=force)
    asked = asked_for(difference or [])
    if len(recordings) == 1 and (asked or align != "t"):
        raise BadInputError("--align and --difference compare two runs; name the other recording too")
    _check(recordings, existing, {"page": html, "overlay": overlay, "export": export, "trajectory": trajectory})
    read_run = read_for_figures
    if html is not None:
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
    if together is None:
        print_result(as_json, found[0], _one(found[0]))
        return
    different, changed = differences(*found), changes(*runs)
    both: dict[str, Any] = {"runs": found, "differences": [row._asdict() for row in different]}
    both["aligned"] = together.figures()
    both["changes"] = [change._asdict() for change in changed]
    lines = ["", *table(together.rows())] if asked or align != "t" else []
    print_result(as_json, both, itertools.chain(_two(found, different, changed), lines))


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


def _one(found: Mapping[str, Any]) -> Iterator[str]:
    """Yield the run, why it failed, its events and its figures, on one screen."""
    from hil.judge.words import belief_rows, figure_rows, link_rows, outcome_rows

    yield from rows(_about(found))
    passed = found["passed"]
    yield from rows([("passed", "not known" if passed is None else "yes" if passed else "no")])
    yield from rows(_failure(found))
    yield from rows(outcome_rows(found))
    yield from rows(_event_rows(found))
    yield ""
    yield from rows((*figure_rows(found), *belief_rows(found), *link_rows(found)))


def _failure(found: Mapping[str, Any]) -> list[tuple[str, str]]:
    return [] if found["failure"] is None else [("failure", found["failure"])]


def _about(found: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield what ran, when and by which version, and the notes on the recording."""
    made = found["made"]
    if found["scenario"] is not None:
        law = f"{found['law']} in {made['command']} mode" if "command" in made else found["law"]
        yield "run", f"{found['scenario']}, {law}, {found['mode']} over {found['link']}, seed {found['seed']}"
        by = [f"{name} {made[key]}" for name, key in (("version", "mecanum_hil"), ("commit", "commit")) if key in made]
        if "started" in made:
            yield "made", f"{made['started']}, {' '.join(by)}"
    yield from (("note", sentence) for sentence in found["notes"])


def _event_rows(found: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the newest warnings and errors that are not printed above."""
    printed = [found["failure"] or "", *(row["text"] for row in found["expect"] or ())]
    warned = [event for event in found["events"] if event["level"] in ("WARN", "ERROR")]
    # The first violation of an expectation is logged at once; its final text begins with the same words.
    events = [event for event in warned if not any(text.startswith(event["text"]) for text in printed)]
    if len(events) > _EVENTS_SHOWN:
        yield "events", f"the last {_EVENTS_SHOWN} of {len(events)}; --json and --html have them all"
    for event in events[-_EVENTS_SHOWN:]:
        yield "event", f"{event['t_s']:.3f} s {event['level']}: {event['text']}"


def _two(
    found: Sequence[Mapping[str, Any]], different: "Sequence[Difference]", changed: "Sequence[Change]"
) -> Iterator[str]:
    """Yield both runs, every figure of both, and the differences of their scenarios."""
    for which, run in zip(("first", "second"), found, strict=True):
        yield from rows([(which, run["recording"]), *_about(run), *_failure(run)])
    head = ("figure", "first", "second", "difference", "", "the second is")
    yield from ("", *table([head, *map(_difference_row, different)]))
    yield from dict.fromkeys(f"  {row.label}: {note}" for row in different for note in row.notes)
    if changed:
        shown = [(key, *map(_short, values)) for key, *values in (one.words() for one in changed[:_CHANGES_SHOWN])]
        yield from ("", *table([("what is different", "first", "second"), *shown]))
    if len(changed) > _CHANGES_SHOWN:
        yield f"{len(changed) - _CHANGES_SHOWN} more; --json and --html have them all"


def _difference_row(row: "Difference") -> tuple[str, ...]:
    def text(value: float | None, form: str) -> str:
        return "-" if value is None else f"{value * row.scale:{form}} {row.unit}".rstrip()

    ratio = "" if not row.first or not row.difference else f"{100 * row.difference / abs(row.first):+.3g} %"
    difference = text(row.difference, "+.4g") if row.difference else "0" if row.difference == 0 else "-"
    return row.label, text(row.first, ".5g"), text(row.second, ".5g"), difference, ratio, row.verdict or ""


def _short(text: str) -> str:
    return text if len(text) <= _LONGEST_VALUE else f"{text[: _LONGEST_VALUE - 1]}…"
