"""A run: from a scenario to its parts, the tick, its schedule, real time, faults, recovery, and the result.

May import: `judge`, `scenario`, `drivers`, `robot`, `wire`, `plant`, `record`, and what these may.
To add a part of the tick: `tick.py` and its maker in `parts.py`.
"""
