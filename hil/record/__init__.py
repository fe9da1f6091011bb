"""Recordings: rows through shared memory to a process that writes .rrd or .mcap, live viewers, layout (RECORDING.md).

May import: `faults`, `core`. `session` is the run's side.
To add a view: `blueprint.py`; a format: `parts.py`.
"""

from hil.record.files import Rotation, check_is_recording, check_output_path, rotation
from hil.record.recording import Recording, RecordingReport, RunRecording, early_recorder

__all__ = [
    "Recording",
    "RecordingReport",
    "Rotation",
    "RunRecording",
    "check_is_recording",
    "check_output_path",
    "early_recorder",
    "rotation",
]
