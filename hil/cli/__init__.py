"""The user interface: a file for each command of `hil`, the tables they print, and the pytest plugin.

May import: every package. To add a command: one file here, and its row in `commands.py`.
"""
