"""``hil view`` and ``hil live``: the rerun viewer, on a recording and on a run under way."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from hil.cli.options import LIVE_PORT, InBrowser
from hil.cli.output import end_in_order, say
from hil.record import viewer


def view(recording: Annotated[Path, Argument(metavar="RUN.rrd")], web: InBrowser = False) -> None:
    """Open a recording in the rerun viewer."""
    end_in_order()
    viewer.view(recording, web=web)


def live(
    web: InBrowser = False,
    port: Annotated[int, Option(metavar="PORT", help="that a --live command serves on", min=1, max=65535)] = LIVE_PORT,
) -> None:
    """Open the rerun viewer on a run or service under way, and on each one after it; start it before or after those."""
    end_in_order()
    viewer.live(port, web=web, say=say)
