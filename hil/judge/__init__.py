"""What a run is worth: expectations, figures, results, and the words for them. Pure, but for the results' arrays.

May import: `scenario`, `core`.
To add a figure: a class as `measure.py` describes it, and its row in `SHIPPED` of `figures.py`.
"""
