"""``hil serve``: the controller as a service."""

import sys
from pathlib import Path
from typing import Annotated, Literal

from typer import Option

from hil.cli.options import LIVE_PORT, AllowMotion, LinkUrl, LivePort, RobotFile, ScenarioName, Sets, TruthUrl


def serve(
    config: ScenarioName,
    link: LinkUrl = None,
    truth: TruthUrl = None,
    robot: RobotFile = None,
    record: Annotated[
        Path | None,
        Option(
            metavar="FILE",
            help="record from the start (.rrd, .mcap), to the next free FILE_2, FILE_3 where it is there already; "
            "hil ctl record does later",
        ),
    ] = None,
    live: Annotated[bool, Option("--live", help="serve live viewers on 127.0.0.1, for hil live")] = False,
    live_port: LivePort = LIVE_PORT,
    token_file: Annotated[Path | None, Option(metavar="FILE", help="the API's token; by default a new one")] = None,
    log: Annotated[Literal["text", "json"], Option(help="form of the log's lines on stderr")] = "text",
    sets: Sets = None,
    allow_motion: AllowMotion = False,
    print_unit: Annotated[bool, Option("--print-unit", help="print a systemd unit that serves this, and end")] = False,
) -> None:
    """Serve a robot: armed, driven and recorded by `hil ctl` or over HTTP, until SIGTERM."""
    if print_unit:
        from hil.service.systemd import unit

        print(unit(config, _without_print_unit(sys.argv, config)), end="")
        return
    from hil.scenario import Scenario, load
    from hil.service import logs
    from hil.service.serve import Options
    from hil.service.serve import serve as run

    def loaded() -> Scenario:
        return load(config, set=sets or [], robot=robot, mode="realtime", link=link)

    logs.configure(log, "control")
    token = str(token_file) if token_file is not None else None
    options = Options(record, live_port if live else None, token, truth, allow_motion, log)
    run(loaded(), options, loaded)


def _without_print_unit(words: list[str], config: str) -> list[str]:
    """Return the options of this command line, as given, without --print-unit and the configuration."""
    options = words[words.index("serve") + 1 :]
    options.remove("--print-unit")
    options.remove(config)
    return options
