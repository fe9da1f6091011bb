"""Kinds of faults as data, typical cases, and their page (FAULTS.md).

May import: `core`.
To add a kind: a row in `kinds.py`, a case in `cases.py`, and the code of the part that applies it.
"""
