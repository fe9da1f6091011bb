"""A run as data: a scenario in TOML, its layers stacked, validated and frozen. The shipped ones are in `shipped/`.

May import: `drivers`, `wire`, `faults`, `estimation`, `references`, `laws`, `core`. To add a key: the frozen dataclass
of its table, here (`tables.py`, `plant.py`, `trial.py`) or in the package that uses it (`hil.core.model`,
`hil.estimation`); `hil.core.options` says how ranges and meanings are written.

``load("paper_circle", set=["robot.mass_kg=24"])`` returns a Scenario, ``resolved(scenario)`` every value and where it
came from, ``shipped_scenarios()`` and ``suite_scenarios()`` the names that ``load`` takes.
"""

from hil.core.options import format_value
from hil.scenario.load import (
    BASE,
    Sources,
    from_values,
    load,
    read,
    robot_model,
    set_texts,
    shipped_scenarios,
    suite_scenarios,
)  # fmt: skip
from hil.scenario.plant import SHIPPED_FMUS
from hil.scenario.run import Scenario, Unpacked, from_plain, resolved, to_plain
from hil.scenario.tables import DeviceTable, FirmwareTable, RealtimeTable, ServiceTable
from hil.scenario.trial import ExpectTable, FaultTable
from hil.scenario.values import StartValue

__all__ = [
    "BASE", "SHIPPED_FMUS", "DeviceTable", "ExpectTable", "FaultTable", "FirmwareTable", "RealtimeTable", "Scenario",
    "ServiceTable", "Sources", "StartValue", "Unpacked", "format_value", "from_plain", "from_values", "load", "read",
    "resolved", "robot_model", "set_texts", "shipped_scenarios", "suite_scenarios", "to_plain",
]  # fmt: skip
