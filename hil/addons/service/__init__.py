"""The controller as a service (SERVICE.md), and teleop: driving by hand.

One process runs the ticks and owns the robot; another answers HTTP, and a third takes emergency stops alone.

May import: `runtime` and the packages below it. To add an order: `messages.py`, `orders.py`, and its arguments in
`api/bodies.py`; `hil ctl` if it has arguments.
"""

from hil.core.extensions import Command

COMMANDS = {
    "serve": Command(
        "Connect and drive",
        "hil.addons.service.serve_command:serve",
        "Serve a robot: armed, driven and recorded by `hil ctl` or over HTTP, until SIGTERM.",
    ),
    "ctl": Command(
        "Connect and drive",
        "hil.addons.service.ctl_command:app",
        "Drive the robot that hil serve runs; an order returns when accepted.",
    ),
    "teleop": Command(
        "Connect and drive",
        "hil.addons.service.ctl_command:teleop",
        "Drive the robot that hil serve runs, by hand: it moves while a key or the gamepad's button is held.",
    ),
}
