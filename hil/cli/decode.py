"""``hil decode``: a trace of the bus, decoded by wheel.dbc."""

import math
import sys
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from hil.cli.output import drop_output, print_json, print_result, say_on_stderr, table
from hil.core.errors import BadInputError
from hil.wire.trace import decode as decoder


def decode(
    trace: Annotated[Path, Argument(metavar="FILE", help="a .blf, .asc, .log (candump -L) or .trc file")],
    message: Annotated[list[str] | None, Option(metavar="NAME", help="only this message; repeatable")] = None,
    from_s: Annotated[float, Option("--from", metavar="S", help="seconds after the first frame")] = 0.0,
    to_s: Annotated[float, Option("--to", metavar="S", help="the last second; by default the end")] = math.inf,
    counts: Annotated[bool, Option("--counts", help="how many frames of each message instead")] = False,
    raw: Annotated[bool, Option("--raw", help="decode no frame: they are of other makers' motors")] = False,
    as_json: Annotated[bool, Option("--json", help="one JSON object a line: for each frame, or for all")] = False,
) -> None:
    """Print a trace of the bus in the terms of the wheel-command protocol."""
    read = decoder.read(trace, decoder.Selection.of(message or [], from_s, to_s, raw=raw))
    try:
        if not read.is_ours:
            say_on_stderr(
                f"hil: note: {trace} has no TICK of our firmware, and most of its frames are not ours; other makers "
                "use the same identifiers, so all frames are printed as they are"
            )
        if not counts:
            for entry in read:
                print_json(entry.record()) if as_json else print(entry.text())
            if read.trouble is None and read.selected == 0:
                say_on_stderr(f"hil: no frame is what was asked for: {read.contents()}")
        else:
            found = decoder.count(read)
            if read.frames or read.trouble is None:
                head = ("message", "id", "frames", "per s")
                print_result(as_json, [row._asdict() for row in found], table([head, *(row.texts() for row in found)]))
        sys.stdout.flush()
    except BrokenPipeError:  # the reader of stdout has left, as head does
        drop_output()
        raise typer.Exit(0) from None
    if read.trouble is not None:
        say_on_stderr(f"hil: {read.trouble}")
        raise typer.Exit(BadInputError.exit_code)
