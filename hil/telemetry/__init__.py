"""Telemetry: one tap, in another process. ``session`` is the run's side."""

from hil.telemetry.session import Recording, RecordingReport, check_recording_path

__all__ = ["Recording", "RecordingReport", "check_recording_path"]
