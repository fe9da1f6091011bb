"""Types, units, signals, errors, ports, the robot's model, and small tools that every room uses.

May import: `firmware_protocol`.
To add a signal: `signals.py`, then the place that fills it (`hil/runtime/rows.py`).
"""
