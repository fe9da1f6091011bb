"""Control laws: pure functions of reference, state and time step (LAWS.md). No clock, no link, no plant.

May import: `core`.
To add a law: one file here and a row in `registry.py`, or an entry point `hil.laws` in a package of your own.
"""
