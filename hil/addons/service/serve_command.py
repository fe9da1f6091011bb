"""``hil serve``: the controller as a service."""

import os
import signal
import sys
import threading
from pathlib import Path
from typing import Annotated, Literal

from typer import Option

from hil.cli.options import (
    LIVE_PORT,
    AllowMotion,
    LinkUrl,
    LivePort,
    RobotFile,
    ScenarioName,
    Sets,
    TruthUrl,
    load_scenario,
)
from hil.core.extras import need
from hil.core.subprocesses import wait_for_end


def serve(
    config: ScenarioName,
    link: LinkUrl = None,
    truth: TruthUrl = None,
    robot: RobotFile = None,
    record: Annotated[
        str,
        Option(
            metavar="NAME|none",
            help="record from the start (.rrd, .mcap) in service.recordings, to the next free NAME_2, NAME_3 where it "
            "is there already; by default none, and hil ctl record does later",
        ),
    ] = "none",
    live: Annotated[bool, Option("--live", help="serve live viewers on 127.0.0.1, for hil live")] = False,
    live_port: LivePort = LIVE_PORT,
    token_file: Annotated[Path | None, Option(metavar="FILE", help="the API's token; by default a new one")] = None,
    clients: Annotated[
        Path | None,
        Option(metavar="FILE", help="further tokens, each a line NAME ROLE[,ROLE] TOKEN"),
    ] = None,
    audit: Annotated[
        Path | None, Option(metavar="FILE", help="record who gave which order; by default in your state folder")
    ] = None,
    log: Annotated[
        Literal["text", "json"], Option(metavar="text|json", help="form of the log's lines on stderr")
    ] = "text",
    sets: Sets = None,
    allow_motion: AllowMotion = False,
    lifeline: Annotated[
        int | None, Option(metavar="FD", help="end in order when this pipe, a descriptor, ends", hidden=True)
    ] = None,
    print_unit: Annotated[bool, Option("--print-unit", help="print a systemd unit that serves this, and end")] = False,
) -> None:
    """Serve a robot: armed, driven and recorded by `hil ctl` or over HTTP, until SIGTERM."""
    if print_unit:
        from hil.addons.service.systemd import unit

        print(unit(config, _without_print_unit(sys.argv, config)), end="")
        return
    need("service", "hil serve")
    from hil.addons.service import logs
    from hil.addons.service.control_process import ServeOptions
    from hil.addons.service.control_process import serve as run

    logs.configure(log, "control")
    token, others, trail = (None if file is None else str(file.absolute()) for file in (token_file, clients, audit))
    name = None if record == "none" else record
    options = ServeOptions(name, live_port if live else None, token, others, trail, truth, allow_motion, log)
    if lifeline is not None:
        _terminate_at_end(lifeline)
    run(load_scenario(config, set=sets or [], robot=robot, mode="realtime", link=link), options)


def _terminate_at_end(descriptor: int) -> None:
    """Send this process SIGTERM when a pipe ends, so that it ends in order. Returns at once."""

    def terminate() -> None:
        wait_for_end(descriptor)
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=terminate, name="lifeline", daemon=True).start()


def _without_print_unit(words: list[str], config: str) -> list[str]:
    """Return the options of this command line, as given, without --print-unit and the configuration."""
    options = words[words.index("serve") + 1 :]
    options.remove("--print-unit")
    options.remove(config)
    return options
