"""``hil decode``: a trace of the bus, decoded by wheel.dbc."""

import contextlib
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from hil.cli.options import drop_output, print_json
from hil.core.errors import BadInputError


def decode(
    trace: Annotated[Path, typer.Argument(metavar="FILE", help="a .blf, .asc, .log (candump -L) or .trc file")],
    message: Annotated[
        list[str] | None, typer.Option("--message", metavar="NAME", help="only this message; may be repeated")
    ] = None,
    from_s: Annotated[float, typer.Option("--from", metavar="S", help="seconds after the first frame")] = 0.0,
    to_s: Annotated[float, typer.Option("--to", metavar="S")] = math.inf,
    counts: Annotated[bool, typer.Option("--counts", help="how many frames of each message instead")] = False,
    raw: Annotated[
        bool, typer.Option("--raw", help="bare frames: of a robot with another maker's motor controllers")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="one JSON object a line: for each frame, or for all")] = False,
) -> None:
    """Print a trace of the bus in the terms of the wheel-command protocol."""
    from hil.wire.trace import decode as decoder

    with _quiet_when_the_reader_leaves():
        read = decoder.read(trace, decoder.Selection.of(message or [], from_s, to_s, raw=raw))
        if counts:
            found = decoder.count(read)
            if as_json and (read.frames or read.trouble is None):
                print_json([row._asdict() for row in found])
            elif read.frames or read.trouble is None:
                from hil.cli import report

                report.print_table([("message", "id", "frames", "per s"), *(row.texts() for row in found)])
        else:
            for entry in read:
                if as_json:
                    print_json(entry.record())
                else:
                    print(entry.text())
        sys.stdout.flush()
    if read.trouble is not None:
        print(f"hil: {read.trouble}", file=sys.stderr)
        raise typer.Exit(BadInputError.exit_code)


@contextlib.contextmanager
def _quiet_when_the_reader_leaves() -> Iterator[None]:
    """Exit quietly when the reader of stdout has left, as head does."""
    try:
        yield
    except BrokenPipeError:
        drop_output()
        raise typer.Exit(0) from None
