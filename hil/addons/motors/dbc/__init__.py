"""Motor controllers whose CAN messages are in a DBC: a mapping table in the scenario instead of a driver (DBC.md)."""
