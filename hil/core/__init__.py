"""Types, units, signals, errors, ports, the robot's model, the limiter, and small tools that every room uses.

May import: `firmware_protocol`.
To add a signal: `signals.py`, then the place that fills it (`hil/runtime/row.py`).
"""

TEST_SUFFIX = ".hil.toml"
"""Ends the name of a scenario file that pytest collects as a test. It is no part of the scenario's name."""
