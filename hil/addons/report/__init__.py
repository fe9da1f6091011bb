"""Recordings seen: the viewer's layout, reviews, two runs compared, exports, traces (README.md).

Draws a recording in a viewer: `run_drawing.py` and the modules that it calls. To add a chart to the page of a review:
`panels.py` (`charts.py` says what a chart is, `charts.js` draws it); an export: `review_command.py`.
"""

from hil.core.extensions import Command

COMMANDS = {
    "review": Command(
        "Look",
        "hil.addons.report.review_command:review",
        "Report from its recording alone how a run went and why; with two runs, which figures became better or worse.",
    ),
    "view": Command(
        "Look",
        "hil.addons.report.commands:view",
        "Open a recording in the rerun viewer.",
    ),
    "live": Command(
        "Look",
        "hil.addons.report.commands:live",
        "Open the rerun viewer on a run or service under way, and on each one after it; start it before or after "
        "those.",
    ),
    "decode": Command(
        "Look",
        "hil.addons.report.commands:decode",
        "Print a trace of the bus in the terms of the wheel-command protocol.",
    ),
    "export": Command(
        "Tools",
        "hil.addons.report.commands:export_app",
        "Write a robot for other programs: its description as a URDF.",
    ),
}
