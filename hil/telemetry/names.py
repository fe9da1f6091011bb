"""Names that the writer and the reader of a recording share."""

APPLICATION = "mecanum-hil"
RUN_PROPERTY = "run"
SIGNALS_PROPERTY = "signals"
SUMMARY_PROPERTY = "summary"
RECORDER_PROPERTY = "recorder"
OVERLAY_PROPERTY = "overlay"
"""Of which two recordings a file is the overlay; such a file is for the viewer, and no recording of a run."""
SIGNALS_PATH = "/signals"
"""The entity of an .rrd file that holds every signal of every row."""
PART_PROPERTY = "part"
"""Which file of the run it is: the run's ``recording_id``, its ``number`` from 1, ``first_row`` and ``first_event``.

The last two count the run's rows and events from 0: one that is in two parts, for a recorder was killed before it could
say that it had written it, is taken from the later part.
"""


def state_names() -> dict[int, str]:
    """Return the names of the robot's states by number (DBC TICK.state)."""
    from firmware_protocol.generated.messages import State

    return {int(state): state.name for state in State}
