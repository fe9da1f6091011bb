"""Options that several commands share."""

from pathlib import Path
from typing import Annotated

import typer

ScenarioName = Annotated[str, typer.Argument(metavar="SCENARIO", help="a shipped name or a path to a .toml file")]
Sets = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="override any key, for example robot.mass_kg=24")
]
RobotFile = Annotated[Path | None, typer.Option("--robot", metavar="FILE", help="merge a robot's own file")]
Mode = Annotated[str | None, typer.Option(metavar="lockstep|realtime", help="as fast as possible, or by the clock")]
LinkUrl = Annotated[
    str | None, typer.Option("--link", metavar="LINK", help="memory:, serial:PATH, serial:pty or can:INTERFACE/CHANNEL")
]
PortOrBus = Annotated[str, typer.Argument(metavar="LINK", help="serial:PATH or can:INTERFACE/CHANNEL")]
Seed = Annotated[int | None, typer.Option(metavar="N", help="of everything random in the run")]
TraceFile = Annotated[
    Path | None, typer.Option("--trace", metavar="FILE.blf|.asc|.log", help="write what is on the wire, for bus tools")
]
Force = Annotated[bool, typer.Option("--force", help="replace files that are there already")]
TruthUrl = Annotated[
    str | None, typer.Option("--truth", metavar="URL", help="truth socket of hil device, tcp://127.0.0.1:PORT")
]
LIVE_PORT = 9876
LivePort = Annotated[int, typer.Option(metavar="PORT", help="for --live", min=1, max=65535)]
InBrowser = Annotated[bool, typer.Option("--web", help="in the browser, served on 127.0.0.1")]
AllowMotion = Annotated[bool, typer.Option("--allow-motion", help="real motors may move")]
ServiceUrl = Annotated[str | None, typer.Option("--url", metavar="URL", help="http://127.0.0.1:PORT")]
ServicePort = Annotated[
    int | None, typer.Option("--port", metavar="PORT", help="which service, when several run", min=1, max=65535)
]
TokenFile = Annotated[
    Path | None, typer.Option("--token-file", metavar="FILE", help="with the token; by default the service's own")
]
Jobs = Annotated[int | None, typer.Option(metavar="N", help="processes; by default one a processor", min=1)]
Limit = Annotated[float, typer.Option("--limit", metavar="S", help="a run that takes longer is ended as hung", min=1.0)]
Json = Annotated[bool, typer.Option("--json", help="print one JSON object and nothing else")]
