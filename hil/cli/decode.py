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
    channel: Annotated[list[str] | None, Option(metavar="NAME", help="only this bus; repeatable")] = None,
    from_s: Annotated[
        float, Option("--from", metavar="S", show_default=False, help="seconds after the first frame; by default all")
    ] = -math.inf,
    to_s: Annotated[
        float, Option("--to", metavar="S", show_default=False, help="the last second; by default the end")
    ] = math.inf,
    counts: Annotated[bool, Option("--counts", help="how many frames of each message instead")] = False,
    raw: Annotated[bool, Option("--raw", help="decode no frame: they are of other makers' motors")] = False,
    as_json: Annotated[bool, Option("--json", help="one JSON object a line: for each frame, or for all")] = False,
) -> None:
    """Print a trace of the bus in the terms of the wheel-command protocol."""
    read = decoder.read(trace, decoder.Selection.of(message or [], from_s, to_s, raw=raw, channels=channel or []))
    try:
        if read.foreign:
            buses = " and ".join(sorted(f"channel {one}" for one in read.foreign if one is not None))
            say_on_stderr(
                f"hil: note: {trace} has no TICK of our firmware{f' on {buses}' * bool(buses)}, and most of the frames "
                "there are not ours; other makers use the same identifiers, so those frames are printed as they are"
            )
        if not counts:
            for entry in read:
                print_json(entry.record()) if as_json else print(entry.text())
            if read.trouble is None and read.selected == 0:
                say_on_stderr(f"hil: no frame is what was asked for: {read.contents()}")
        else:
            found = decoder.count(read)
            if read.frames or read.trouble is None:
                head = ("message", "id", "frames", "per s", "channel")
                print_result(as_json, [row._asdict() for row in found], table([head, *(row.texts() for row in found)]))
        sys.stdout.flush()
        if (rest := read.rest()) is not None:
            say_on_stderr(f"hil: note: {rest}")
    except BrokenPipeError:  # the reader of stdout has left, as head does
        drop_output()
        raise typer.Exit(0) from None
    if read.trouble is not None:
        say_on_stderr(f"hil: {read.trouble}")
        raise typer.Exit(BadInputError.exit_code)
