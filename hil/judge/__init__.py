"""What a run is worth: expectations, figures, results, and the words for them. Pure, but for the results' arrays.

May import: `scenario`, `core`.
To add a figure: `metrics.py`, and its words in `hil/core/figure_words.py`.
"""
