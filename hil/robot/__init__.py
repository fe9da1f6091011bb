"""A robot with our firmware: the host's session with it, the virtual robot, emulated boards, and the true pose.

May import: `wire`, `plant`, `faults`, `core`, `firmware_protocol`.
To add a target that runs the firmware: one file in `targets/`.
"""
