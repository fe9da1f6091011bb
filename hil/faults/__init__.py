"""Kinds of faults (FAULTS.md).

May import: `core`, `firmware_protocol`.
To add a kind: its row in `kinds.py` with its effect, in `link_faults.py` a class if it does more to a link than change
frames, and a case in `hil/addons/batch/catalogue/fault_cases.py`.
"""
