"""``hil live``: the viewer for a run under way."""

from typing import Annotated

import typer

from hil.cli.options import end_in_order

LIVE_PORT = 9876


def live(
    web: Annotated[bool, typer.Option("--web", help="in the browser, served on 127.0.0.1")] = False,
    port: Annotated[
        int, typer.Option(metavar="PORT", help="that hil run --live or hil serve --live serves on", min=1, max=65535)
    ] = LIVE_PORT,
) -> None:
    """Open the rerun viewer on a run or service under way, and on each one after it; start it before or after those."""
    from hil.record.follow import live as show

    end_in_order()
    show(port, web=web, say=lambda sentence: print(sentence, flush=True))
