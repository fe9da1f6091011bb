"""Types, units, signals, errors, ports, the robot's model, the command limiter, and tools that every package uses.

May import: `firmware_protocol`.
To add a signal: `signals.py`, then the place that fills it (`hil/runtime/row.py`).
"""

TEST_SUFFIX = ".hil.toml"
"""File name suffix of a scenario that pytest collects as a test. The scenario's name does not include it."""
