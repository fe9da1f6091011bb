"""How good a run was: its figures, expectations and verdict, and their texts; from its rows, or from its recording.

EXPECTATIONS.md says what a run is judged by. ``judged_run.py`` holds a run as it was judged, and ``decide``.
May import: `scenario`, `record`, `faults`, `core`. To add a figure: a class as `measure.py` describes it, and
its row in `MEASURES` of `figures.py`.
"""
