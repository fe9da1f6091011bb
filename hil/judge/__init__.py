"""How good a run was: expectations, figures, results, and their texts. No side effects, except on arrays of results.

EXPECTATIONS.md says what a run is judged by; ``baselines.py`` compares it with its scenario's baseline.
May import: `scenario`, `core`. To add a figure: a class as `measure.py` describes it, and its row in `SHIPPED` of
`figures.py`.
"""
