"""A robot: the host's session with it, the virtual robot, the true pose, and the interface of makers' drivers.

May import: `wire`, `plant`, `faults`, `core`, `firmware_protocol`.
To add a board that runs the firmware: an entry point of the group `hil.boards` (`boards.py`).
"""
