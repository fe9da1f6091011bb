"""Telemetry: one tap, in another process. ``session`` is the run's side."""

from hil.telemetry.files import check_is_recording, check_output_path
from hil.telemetry.session import Recording, RecordingReport, RunRecording

__all__ = ["Recording", "RecordingReport", "RunRecording", "check_is_recording", "check_output_path"]
