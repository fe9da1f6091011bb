"""The host's half of the wheel protocol, in C (``client/wheel_client.h``): messages, snapshots and the session.

``Client`` has no I/O. It takes the packed frames that a robot sent, and holds those that are to be sent to it.
"""

import hashlib
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from firmware_protocol.extension import library, wheel
from firmware_protocol.generated.messages import Mode, Request, State
from firmware_protocol.host_line import PackedFrames

_STATES = tuple(State)
MOST_TICKS = 1000
"""The most that one STEP runs (wheel.dbc, STEP.substeps)."""
_LOG_BYTES = 1 << 15
NO_TIME = -1
"""The time [ns] in place of one that is not known: a round trip is not measured then, no heartbeat follows."""


class Client(wheel.Client):
    """The host's session with one robot. ``wheel_client.h`` explains the calls; their names are the same.

    ``parameter_check`` is the low byte of the parameter hash that the robot must have. ``feedback`` and ``wheels`` are
    the classes of what ``feedback()`` returns, and of four numbers in it. Times are those of one clock [ns]. Raises
    BuildError when the extension module cannot be loaded.

    Attributes:
        handle: the C struct, for cffi; valid as long as this object.
        view: ``wheel_view``, what is known of the robot. Look at it after each ``take``.
        keep: gets what the logs hold, sent and received, before they are emptied.
    """

    def __init__(
        self, mode: Mode, parameter_check: int, nonce: int, feedback: type[NamedTuple], wheels: type[NamedTuple]
    ) -> None:
        super().__init__(mode, parameter_check, nonce, feedback, wheels, _STATES)
        ffi, lib = library()
        self._ffi, self._lib = ffi, lib
        self.handle = ffi.cast("wheel_client *", self.address)
        self.view: Any = lib.wheel_client_view(self.handle)
        self._round_trips_ns = memoryview(ffi.buffer(self.view.round_trips_ns)).cast("q")
        self._logs = ffi.new("uint8_t[]", _LOG_BYTES), ffi.new("uint8_t[]", _LOG_BYTES)
        lib.wheel_client_log(self.handle, *self._logs, _LOG_BYTES)
        self._logged = ffi.new("size_t[2]")
        self._hashes = hashlib.sha256(), hashlib.sha256()
        self.keep: Callable[[bytes, bytes], None] | None = None

    def wire(self, wheel_of_channel: Sequence[int], sign_of_channel: Sequence[int]) -> None:
        """Set which wheel each robot channel drives, and its direction; the values in ``view`` are then per wheel.

        Raises ValueError unless that is a permutation of 0 to 3 with signs 1 and -1.
        """
        if not self._lib.wheel_client_wire(self.handle, tuple(wheel_of_channel), tuple(sign_of_channel)):
            raise ValueError(f"wheels {tuple(wheel_of_channel)} with signs {tuple(sign_of_channel)} on the channels")

    # What the robot sends

    def round_trips_ns(self, begin: int) -> list[int]:
        """Return the round trips from this number on, oldest first, of the newest 256."""
        count, newest = self.view.round_trips, self._round_trips_ns
        begin = max(begin, count - 256)
        first, end = begin % 256, begin % 256 + count - begin
        return newest[first:end].tolist() + newest[: max(0, end - 256)].tolist()

    # What is sent to the robot

    def out(self) -> PackedFrames:
        """Return the frames that wait to be sent; call ``sent`` or ``unsent`` then."""
        return PackedFrames(self.packed(), self.view.out_frames)

    def unsent(self) -> None:
        """The frames of ``out`` could not be sent; they do not count."""
        self._lib.wheel_client_unsent(self.handle)

    def arm(self, now_ns: int) -> int:
        """Take the next step towards ACTIVE; return it (``WHEEL_ARMING_...``)."""
        step: int = self._lib.wheel_client_arm(self.handle, now_ns)
        return step

    def request(self, request: Request, now_ns: int) -> None:
        """Set what the heartbeats ask for, and add the first one."""
        self._lib.wheel_client_request(self.handle, request, now_ns)

    def estop(self) -> None:
        """Add ESTOP."""
        self._lib.wheel_client_estop(self.handle)

    def add(self, number: int, payload: bytes) -> None:
        """Add one message of another kind. Raises ValueError when it has not the length of its id, or has no room."""
        if not self._lib.wheel_client_add(self.handle, number, payload, len(payload)):
            raise ValueError(f"message {number:#05x} of {len(payload)} bytes cannot be sent")

    def step(self, ticks: int) -> None:
        """Lockstep: add a STEP of so many ticks; 0 asks for the robot's tick. Raises ValueError for more than 1000."""
        if ticks > MOST_TICKS or not self.ask(ticks):
            raise ValueError(f"STEP of {ticks} ticks cannot be sent; expected at most {MOST_TICKS}")

    def step_again(self) -> None:
        """Add the same STEP again, because no answer came."""
        self._lib.wheel_client_step_again(self.handle)

    # The session

    def leave(self) -> None:
        """Leave the robot, because the link or the robot was lost."""
        self._lib.wheel_client_leave(self.handle)

    def begin(self, nonce: int) -> None:
        """Leave the robot, and begin anew with one that may have been reset, or may be another."""
        self._lib.wheel_client_begin(self.handle, nonce)

    def renew(self, nonce: int) -> None:
        """Begin another session with the same robot."""
        self._lib.wheel_client_renew(self.handle, nonce)

    # The log

    def hash_log(self) -> None:
        """Hash what the logs hold; due when ``view.log_is_due``."""
        self._lib.wheel_client_log_take(self.handle, self._logged)
        logs = [self._ffi.buffer(log, used) for log, used in zip(self._logs, self._logged, strict=True)]
        for log, digest in zip(logs, self._hashes, strict=True):
            digest.update(log)
        if self.keep is not None:
            self.keep(*map(bytes, logs))

    def hexdigest(self) -> str:
        """Return the hash of the session so far: the frames of each direction, in order."""
        self.hash_log()
        sent, received = self._hashes
        return hashlib.sha256(sent.digest() + received.digest()).hexdigest()
