"""Chaos on loopback: real processes of a served virtual robot, to which a seed does things at random times.

``world`` starts the processes and knows them, ``line`` is the cable between host and robot, ``events`` are what can
happen, and ``judge`` watches the robot's truth and what the service says of it. ``python -m tools.chaos`` runs it.
"""
