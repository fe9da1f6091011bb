"""The controller as a service: one process ticks and owns the robot, another one answers HTTP on this machine."""
