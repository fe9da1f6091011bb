"""Control laws: pure functions of reference, state and time step (LAWS.md). No clock, no link, no plant.

May import: `core`, `firmware_protocol`.
To add a law: one file here, and an entry point of the group `hil.laws` in pyproject.toml; another
package does the same.
"""
