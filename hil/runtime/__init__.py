"""Runs a scenario: makes its parts, runs the ticks on schedule, injects faults, recovers, and reports the result.

May import: `judge`, `scenario`, `robot`, `wire`, `plant`, `record`, and what these may. To add a part of the tick: use
it in `tick.py` and make it in `run_parts.py`.
"""
