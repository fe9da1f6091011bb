"""``hil replay``: another law computed from a recording."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from hil.cli.options import LAW, LAW_HELP, Force, Json
from hil.cli.output import print_result, table
from hil.core.outputs import existing_files

if TYPE_CHECKING:
    from hil.review.replay import Replay


def replay(
    recording: Annotated[Path, Argument(metavar="RUN", help="recording of a run")],
    law: Annotated[str, Option(metavar=LAW, help=LAW_HELP)],
    record: Annotated[
        str, Option(metavar="FILE.rrd|none", help="record the run with the replayed commands; by default none")
    ] = "none",
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Open loop: feed a recording's states and references to another law, and show how its commands differ."""
    from hil.record import check_output_path
    from hil.review import read
    from hil.review.replay import replay as replay_run
    from hil.review.replay import write_replay

    existing, out = existing_files(force=force), None if record == "none" else Path(record)
    if out is not None and out.resolve() != recording.resolve():
        check_output_path("recording", out, existing)
    run = read(recording)
    replayed = replay_run(run, law)
    if out is not None:
        write_replay(run, replayed, out, existing)
    found = {**replayed.figures(), "recorded": None if out is None else str(out)}
    print_result(as_json, found, _lines(replayed))


def _lines(replayed: "Replay") -> Iterator[str]:
    gains = "".join(f", {name} = {value}" for name, value in replayed.gains.items())
    yield f"{replayed.law}{gains} on {replayed.path}, where {replayed.recorded_law} was in command"
    yield replayed.figures()["label"]
    yield f"{replayed.asked} of {replayed.ticks} ticks have a command of the law\n"
    head = ("open loop: replayed minus recorded", "rms", "max", "at t [s]", "recorded rms")
    rows = [
        (name, f"{one.rms:.4g}", f"{one.max:.4g}", f"{one.max_s:.3f}", f"{one.recorded_rms:.4g}")
        for name, one in replayed.differences.items()
    ]
    yield from table([head, *rows])
    if replayed.commands_refused:
        yield f"\n{replayed.commands_refused} commands were not finite; each was taken as a stop"
    yield from (f"\nnote: {note}" for note in replayed.notes)
