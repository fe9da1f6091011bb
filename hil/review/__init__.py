"""Recordings read back: figures, comparison of two runs, pages, plots, exports, replay (REVIEW.md).

May import: `judge`, `scenario`, `record`, `laws`, `core`.
To add a chart to the page: `panels.py` (`charts.py` says what a chart is; `drawn_charts.py` and `charts.js` draw it);
a picture: `plots.py`; an export: `export.py`.

result = hil.load("run.rrd")               # what hil.run returned (load.py, result.py)
run = read(Path("run.rrd"))                # every signal; see RecordedRun
figures = review(Path("run.rrd"))          # as hil run --json has them
rows = differences(figures, review(other)) # which of two runs is better, figure by figure
"""

from hil.judge.results import Event
from hil.review.difference import Change, Difference, changes, differences
from hil.review.export import write_trajectory
from hil.review.figures import figures, review
from hil.review.reader import RecordedRun, read, to_frame

__all__ = [
    "Change",
    "Difference",
    "Event",
    "RecordedRun",
    "changes",
    "differences",
    "figures",
    "read",
    "review",
    "to_frame",
    "write_trajectory",
]
