"""Recordings: rows through shared memory to a process that writes .rrd or .mcap, live viewers, layout (RECORDING.md).

May import: `faults`, `estimation`, `core`. `recording.py` is the run's side, `recorder.py` the process.
To add a view: `blueprint.py`; a format: a class as `RunFile` in `run_files.py` describes it.
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
