"""The user interface: a file for each command of the core, and the tables they print.

May import: every package but add-ons, which have their commands. To add one: one file here, and its row in
`commands.py`.
"""
