"""Telemetry: one tap, in another process. ``session`` is the run's side."""

from hil.telemetry.files import Rotation, check_is_recording, check_output_path, rotation
from hil.telemetry.session import Recording, RecordingReport, RunRecording, early_recorder

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
