"""A run as data: a scenario in TOML, its layers stacked, validated and frozen. The shipped ones are in `shipped/`.

May import: `drivers`, `wire`, `faults`, `estimation`, `references`, `laws`, `core`.
To add a key: `tables.py`.

load("paper_circle", set=["robot.mass_kg=24"])    -> Scenario
resolved(scenario)                                -> every value and where it came from
shipped()                                         -> what can be loaded by name
"""

from hil.scenario.allow import AllowTable
from hil.scenario.fields import StartValue
from hil.scenario.load import Sources, load, read, set_texts, shipped
from hil.scenario.plain import from_plain, to_plain
from hil.scenario.process_tables import RealtimeTable, ServiceTable
from hil.scenario.rows import ExpectTable, FaultTable
from hil.scenario.run import Scenario, resolved
from hil.scenario.tables import (
    SHIPPED_FMUS,
    ControllerTable,
    DeviceTable,
    EstimatorTable,
    FirmwareTable,
    LinkTable,
    LoopTable,
    PlantTable,
    ReferenceTable,
    RobotTable,
)
from hil.scenario.toml_text import format_value

__all__ = [
    "SHIPPED_FMUS",
    "AllowTable",
    "ControllerTable",
    "DeviceTable",
    "EstimatorTable",
    "ExpectTable",
    "FaultTable",
    "FirmwareTable",
    "LinkTable",
    "LoopTable",
    "PlantTable",
    "RealtimeTable",
    "ReferenceTable",
    "RobotTable",
    "Scenario",
    "ServiceTable",
    "Sources",
    "StartValue",
    "format_value",
    "from_plain",
    "load",
    "read",
    "resolved",
    "set_texts",
    "shipped",
    "to_plain",
]
