"""The runs of which the documents show pictures, one of each kind."""

from collections.abc import Mapping
from pathlib import Path

from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import load

RUNS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "passed": ("circle_speed", ()),
    "failed": (
        "circle_speed",
        (
            'fault=[{kind="push",target="force_x_n",value=60.0,start_s=6.0,end_s=6.5}]',
            'expect=[{signal="error.planar_m",from_s=4.0,below=0.01},{signal="error.heading_rad",below=0.05}]',
        ),
    ),
    "ended": ("circle_speed", ('fault=[{kind="disconnect",target="link",start_s=3.0,end_s=4.0}]',)),
    "faulty": (
        "circle_speed",
        (
            'fault=[{kind="dead_motor",target="fl",start_s=4.0,end_s=6.0},'
            '{kind="drop",target="feedback",value=0.3,start_s=8.0,end_s=10.0},'
            '{kind="push",target="force_y_n",value=100.0,start_s=11.0,end_s=11.3}]',
        ),
    ),
    "other law": ("circle_speed", ("controller.law=afdsc",)),
}
"""Each run by its name: a shipped scenario, and what is set in it."""


def make_runs(folder: Path) -> dict[str, Path]:
    """Do the runs and return their recordings by name."""
    recordings = {}
    for name, (scenario, sets) in RUNS.items():
        recordings[name] = folder / f"{name}.rrd"
        run_scenario(load(scenario, set=list(sets)), RunOptions(record=recordings[name]))
    return recordings
