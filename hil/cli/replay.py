"""``hil replay``: another law computed from a recording."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.cli.options import Force, Json, print_json

if TYPE_CHECKING:
    from hil.review.replay import Replay


def replay(
    recording: Annotated[Path, typer.Argument(metavar="RUN", help="recording of a run")],
    law: Annotated[str, typer.Option(metavar="LAW[,GAIN=VALUE...]", help="the law to compute")],
    record: Annotated[
        Path | None, typer.Option(metavar="FILE.rrd", help="record the run again with the replayed commands beside it")
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Open loop: feed a recording's states and references to another law, and show how its commands differ."""
    from hil.core.outputs import existing_files
    from hil.record import check_output_path
    from hil.review import read
    from hil.review.replay import replay as replay_run
    from hil.review.replay import write_replay

    existing = existing_files(force=force)
    if record is not None and record.resolve() != recording.resolve():
        check_output_path("recording", record, existing)
    run = read(recording)
    replayed = replay_run(run, law)
    if record is not None:
        write_replay(run, replayed, record, existing)
    if as_json:
        print_json({**replayed.figures(), "recorded": None if record is None else str(record)})
    else:
        _print(replayed)


def _print(replayed: "Replay") -> None:
    from hil.cli import report

    figures = replayed.figures()
    gains = "".join(f", {name} = {value}" for name, value in replayed.gains.items())
    print(f"{replayed.law}{gains} on {replayed.path}, where {replayed.recorded_law} was in command")
    print(figures["label"])
    print(f"{replayed.asked} of {replayed.ticks} ticks have a command of the law\n")
    head = ("open loop: replayed minus recorded", "rms", "max", "at t [s]", "recorded rms")
    rows = [
        (name, f"{one.rms:.4g}", f"{one.max:.4g}", f"{one.max_s:.3f}", f"{one.recorded_rms:.4g}")
        for name, one in replayed.differences.items()
    ]
    report.print_table([head, *rows])
    if replayed.commands_refused:
        print(f"\n{replayed.commands_refused} commands were not finite; each was taken as a stop")
    for note in replayed.notes:
        print(f"\nnote: {note}")
