"""Feedback as one snapshot per tick: a TICK message, then the messages that it announces, in the order of their ids.

A message out of order means that one was lost; the whole snapshot is dropped. Inertial messages carry their sampling
instant, so a snapshot with them never mixes two instants. Without them, a loss from one message up to the same message
of a later snapshot cannot be detected; the later snapshot is then counted as lost.
"""

import struct
from collections.abc import Sequence
from typing import NamedTuple

from firmware_protocol.built import BuildError
from firmware_protocol.generated.messages import State
from firmware_protocol.host import library
from hil.core.errors import BadInputError
from hil.core.types import NAN, NAN_WHEELS, Wheels, make_wheels

_STATES = {int(state): state for state in State}
_unpack = struct.Struct("=2Q7I4f4H4B").unpack  # wheel_snapshot
_unpack_slow = struct.Struct("=8f").unpack


class Feedback(NamedTuple):
    """What the robot measured at one sampling instant.

    ``robot_time_ns`` is the robot's own clock (TICK.time_us), unwrapped since the first snapshot. ``current_a``,
    ``acceleration_m_s2`` and ``yaw_rate_rad_s`` come at a lower rate and keep their last value; NaN before the first.
    Current and acceleration (body frame, 9.81 upwards at rest) are means over the feedback period that ends then.
    """

    robot_time_ns: int
    state: State
    command_sequence: int
    command_age_ms: int
    encoder_count: tuple[int, int, int, int]
    speed_rad_s: Wheels
    current_a: Wheels
    acceleration_m_s2: tuple[float, float, float]
    yaw_rate_rad_s: float


class SnapshotReader:
    """Assembles snapshots and finds STEP_DONE, with the host library. No I/O.

    Attributes:
        feedback: the newest snapshot, None before the first.
        frames: number of frames read.
        incomplete: number of snapshots with a missing message.
        lost: number of snapshots missing by their numbers; a gap of 128 or more is not detected.
        sequences: TICK.sequence of each TICK in the newest ``read``.
        step_done: the tick of the STEP_DONE that ended the newest ``read``, else None.

    Raises BadInputError when the host library cannot be loaded.
    """

    def __init__(self) -> None:
        try:
            ffi, lib = library()
        except BuildError as error:
            raise BadInputError(str(error)) from error
        self._memory = ffi.new("uint64_t[]", lib.wheel_reader_size() // 8 + 1)
        self._reader = ffi.cast("wheel_reader *", self._memory)
        lib.wheel_reader_init(self._reader)
        address = ffi.cast("char *", lib.wheel_reader_snapshot(self._reader))
        slow = ffi.offsetof("wheel_snapshot", "current_a")
        sequences = ffi.offsetof("wheel_snapshot", "sequences")
        self._fast_bytes = ffi.buffer(address, slow)
        self._slow_bytes = ffi.buffer(address + slow, sequences - slow)
        self._ring = memoryview(ffi.buffer(address + sequences, ffi.sizeof("wheel_snapshot") - sequences))
        self._read, self._restart = lib.wheel_reader_take, lib.wheel_reader_restart
        self._completed = self._slow = self._ticks = self._steps_done = 0
        self.sequences: Sequence[int] = ()
        self._held: tuple[Wheels, tuple[float, float, float], float] = (NAN_WHEELS, (NAN, NAN, NAN), NAN)
        self.step_done: int | None = None
        self.feedback: Feedback | None = None
        self.frames = self.incomplete = self.lost = 0

    def restart(self) -> None:
        """Start again with a robot that was lost or reset: its numbers and its clock may have restarted."""
        self._restart(self._reader)

    def read(self, packed: bytes, begin: int) -> int:
        """Read packed frames from offset ``begin``; return the offset of the first frame that was not read.

        It reads valid snapshot messages, and stops after a STEP_DONE or before any other frame.
        """
        end: int = self._read(self._reader, packed, begin, len(packed))
        values = _unpack(self._fast_bytes)
        time_us, self.frames, completed, slow, ticks, self.incomplete, self.lost, steps_done, step_done = values[:9]
        if ticks == self._ticks + 1:  # the usual case
            self._ticks, self.sequences = ticks, values[20:]
        else:
            self.sequences = self._sequences(ticks)
        if completed != self._completed:
            self._completed = completed
            if slow != self._slow:
                self._slow = slow
                at_a_lower_rate = _unpack_slow(self._slow_bytes)
                self._held = make_wheels(at_a_lower_rate[:4]), at_a_lower_rate[4:7], at_a_lower_rate[7]
            state, sequence, age_ms = values[17:20]
            self.feedback = Feedback(
                time_us * 1000, _STATES[state], sequence, age_ms, values[13:17], make_wheels(values[9:13]), *self._held
            )
        if steps_done != self._steps_done:
            self._steps_done = steps_done
            self.step_done = step_done
        else:
            self.step_done = None
        return end

    def _sequences(self, ticks: int) -> Sequence[int]:
        """Return TICK.sequence of the TICKs since the last call, up to number ``ticks``, which wraps at 32 bits."""
        new, self._ticks = (ticks - self._ticks) & 0xFFFF_FFFF, ticks
        return [self._ring[(ticks - before) % len(self._ring)] for before in range(new, 0, -1)]
