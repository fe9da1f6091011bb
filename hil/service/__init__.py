"""The controller as a service: one process ticks and owns the robot, another answers HTTP (SERVICE.md). Teleop.

May import: `runtime` and the rooms below it.
To add an order: `messages.py`, `desk.py`, and its arguments in `api/bodies.py`; `hil ctl` if it has arguments.
"""
