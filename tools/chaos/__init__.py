"""Chaos on loopback: real processes of a served virtual robot, to which a seed does things at random times.

``world`` starts the processes and knows them, ``line`` is the cable between host and robot, ``events`` has the possible
events. ``judge`` compares the robot's true state with the service's reports. ``python -m tools.chaos`` runs it.
"""
