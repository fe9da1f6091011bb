"""The controller as a service (SERVICE.md), and teleop: driving by hand.

One process runs the ticks and owns the robot; another answers HTTP, and a third takes emergency stops alone.

May import: `runtime` and the packages below it. To add an order: `messages.py`, `desk.py`, and its arguments in
`api/bodies.py`; `hil ctl` if it has arguments.
"""
