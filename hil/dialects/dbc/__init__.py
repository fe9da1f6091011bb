"""Motor controllers whose CAN messages are in a DBC: a mapping table in the scenario instead of a driver (DBC.md)."""

from hil.dialects.dbc.driver import DbcDriver
from hil.dialects.dbc.settings import Settings
from hil.dialects.port import Dialect

DIALECT = Dialect(
    title="a device of your own, by its DBC and a mapping",
    wires=frozenset({"can"}),
    settings=Settings,
    make=DbcDriver,
)
