"""``hil view`` and ``hil live``: the rerun viewer, on a recording and on a run under way."""

from pathlib import Path
from typing import Annotated

import typer

from hil.cli.options import LIVE_PORT, end_in_order


def view(
    recording: Annotated[Path, typer.Argument(metavar="RUN.rrd")],
    web: Annotated[bool, typer.Option("--web", help="in the browser, served on 127.0.0.1")] = False,
) -> None:
    """Open a recording in the rerun viewer."""
    from hil.record.viewer import view as open_viewer

    open_viewer(recording, web=web)


def live(
    web: Annotated[bool, typer.Option("--web", help="in the browser, served on 127.0.0.1")] = False,
    port: Annotated[
        int, typer.Option(metavar="PORT", help="that hil run --live or hil serve --live serves on", min=1, max=65535)
    ] = LIVE_PORT,
) -> None:
    """Open the rerun viewer on a run or service under way, and on each one after it; start it before or after those."""
    from hil.record.viewer import live as show

    end_in_order()
    show(port, web=web, say=lambda sentence: print(sentence, flush=True))
