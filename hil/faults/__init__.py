"""Kinds of faults as data, typical cases, and their page (FAULTS.md).

May import: `core`.
To add a kind: its row in `kinds.py`, with its effect where it acts on signals or frames, and a case in `cases.py`.
"""
