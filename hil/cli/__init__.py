"""The ways in: a file for each command of `hil`, what they print, and the pytest plugin.

May import: every room.
To add a command: one file here, and its row in `commands.py`.
"""
