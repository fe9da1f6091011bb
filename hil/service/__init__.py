"""The controller as a service: one process ticks and owns the robot, another answers HTTP (SERVICE.md). Teleop.

May import: `runtime` and what it may.
To add an order: `messages.py`, `desk.py`, and its form in `api/bodies.py`.
"""
