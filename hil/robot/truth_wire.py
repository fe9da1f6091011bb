"""Ground truth by a path of its own: a loopback TCP socket, never the wheel link.

The client sends one JSON line ``{"scenario": HASH, "reset": BOOL}``; the server answers one JSON line, ``{"ok": true}``
or ``{"error": TEXT}``, and then sends records: robot time since power-on, pose, twist, set points, age of the newest
command and state.

Faults of the robot and its plant go the same way, each request in a connection of its own: with ``"faults"`` in its
line, ``{"arm": ROWS}``, ``{"begin": TICK}`` or ``{"applied": true}``, the client gets its answer and no records.
"""

import struct
from typing import NamedTuple

from firmware_protocol.generated.messages import State
from hil.core.types import Pose, PoseFix, Twist, Wheels

RECORD = struct.Struct("<q6d4dIB")
ANSWER_S = 2.0
LONGEST_ANSWER = 65536


class TruthRecord(NamedTuple):
    """A fix with the firmware's set points, the age of its newest command and its state at that time."""

    fix: PoseFix
    set_point_rad_s: Wheels
    command_age_ms: int
    state: State


def unpack(data: bytes | bytearray) -> TruthRecord:
    """Return the record that these bytes are."""
    time_ns, x, y, heading, vx, vy, yaw_rate, fl, fr, rr, rl, age_ms, state = RECORD.unpack(data)
    fix = PoseFix(time_ns, Pose(x, y, heading), Twist(vx, vy, yaw_rate))
    return TruthRecord(fix, Wheels(fl, fr, rr, rl), age_ms, State(state))
