"""Options that several commands share, and the scenario that they make."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

if TYPE_CHECKING:
    from hil.scenario import Scenario

LAW = "LAW[,KEY=VALUE...]"
LAW_HELP = "one of hil list laws, MODULE:CLASS or FILE.py:CLASS, with changed gains"


ScenarioName = Annotated[str, Argument(metavar="SCENARIO", help="a shipped name or a path to a .toml file")]
Sets = Annotated[list[str] | None, Option("--set", metavar="KEY=VALUE", help="override a key, as in robot.mass_kg=24")]
RobotFile = Annotated[Path | None, Option(metavar="FILE", help="merge a robot's own file")]
Mode = Annotated[str | None, Option(metavar="lockstep|realtime", help="as fast as possible, or by the clock")]
LinkUrl = Annotated[str | None, Option(metavar="LINK", help="memory:, serial:PATH, serial:pty, can:INTERFACE/CHANNEL")]
PortOrBus = Annotated[str, Argument(metavar="LINK", help="serial:PATH or can:INTERFACE/CHANNEL")]
Seed = Annotated[int | None, Option(metavar="N", help="seed of everything random in the run")]
TraceFile = Annotated[
    Path | None, Option(metavar="FILE.blf|.asc|.log", help="write the traffic of the wire, for bus tools")
]
Force = Annotated[bool, Option("--force", help="replace files that are there already")]
TruthUrl = Annotated[str | None, Option(metavar="URL", help="truth socket of hil device, tcp://127.0.0.1:PORT")]
LIVE_PORT = 9876
LivePort = Annotated[int, Option(metavar="PORT", help="for --live", min=1, max=65535)]
InBrowser = Annotated[bool, Option("--web", help="in the browser, served on 127.0.0.1")]
AllowMotion = Annotated[bool, Option("--allow-motion", help="real motors may move")]
ServiceUrl = Annotated[str | None, Option(metavar="URL", help="http://127.0.0.1:PORT")]
ServicePort = Annotated[int | None, Option(metavar="PORT", help="which service, when several run", min=1, max=65535)]
TokenFile = Annotated[Path | None, Option(metavar="FILE", help="that holds the token; by default the service's own")]
Jobs = Annotated[int | None, Option(metavar="N", help="processes; by default one a processor", min=1)]
Limit = Annotated[float, Option("--limit", metavar="S", help="a longer run ends as hung", min=1)]
PictureFormat = Annotated[str, Option("--pictures", metavar="png|svg|pdf", help="format of the pictures")]
Json = Annotated[bool, Option("--json", help="print one JSON object and nothing else")]


def load_scenario(name: str, **given: Any) -> "Scenario":
    """Return a scenario as ``hil.scenario.load``, which is imported only now."""
    from hil.scenario import load

    return load(name, **given)
