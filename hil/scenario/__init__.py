"""A run as data: a scenario in TOML, its layers stacked, validated and frozen. The shipped ones are in `shipped/`.

May import: `core`, and of the rooms below options and registries (`hil.laws.law_registry`, `hil.references`,
`hil.robot.driver_registry`, `hil.wire.url`), but no law, driver, plant or link (a contract in pyproject.toml).

To add a key: the frozen dataclass of its table, here (`tables.py`, `plant.py`, `trial.py`) or in the package that uses
it (`hil.core.model`, `hil.estimation`); `hil.core.options` says how ranges and meanings are written.
"""

from hil.core.options import format_value
from hil.scenario.load import (
    BASE,
    Sources,
    from_values,
    load,
    read,
    set_texts,
    shipped_scenarios,
)  # fmt: skip
from hil.scenario.plant import SHIPPED_FMUS
from hil.scenario.scenario import Scenario, from_plain, resolved, to_plain
from hil.scenario.tables import DeviceTable, FirmwareTable, RealtimeTable, ServiceTable
from hil.scenario.trial import ExpectTable, FaultTable
from hil.scenario.values import StartValue

__all__ = [
    "BASE", "SHIPPED_FMUS", "DeviceTable", "ExpectTable", "FaultTable", "FirmwareTable", "RealtimeTable", "Scenario",
    "ServiceTable", "Sources", "StartValue", "format_value", "from_plain", "from_values", "load", "read",
    "resolved", "set_texts", "shipped_scenarios", "to_plain",
]  # fmt: skip
