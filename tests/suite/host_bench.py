"""A bench for one host alone: the client of ``wheel_client.h`` next to the model of its rules.

After each call all that the client shows is compared with the model: its view, the frames that wait, its logs.
"""

from collections.abc import Callable, Sequence
from typing import Any

from firmware_protocol.client import Client
from firmware_protocol.extension import library
from firmware_protocol.framing import Frame, pack
from firmware_protocol.generated.messages import Mode, Request
from hil.core.types import Wheels
from hil.robot.snapshot import Feedback
from tests.suite.host_model import HostModel

_LOG = 2100  # bytes of each log: few, so that they fill up
_OF_SNAPSHOT = (
    *("state", "command_sequence", "command_age_ms", "robot_time_us", "encoder_count", "speed_rad_s", "current_a"),
    *("acceleration_m_s2", "yaw_rate_rad_s", "has_feedback", "snapshots", "lost", "incomplete"),
)
_OF_SESSION = (
    *("request", "is_greeted", "nonce", "tick", "step", "step_target", "step_done_tick", "sent", "received"),
    *("out_of_range", "log_is_due"),
)


class HostBench:
    """Calls client and model alike. Each call raises AssertionError that names the first difference."""

    def __init__(self, mode: Mode, check: int, nonce: int, *, logs: bool = True) -> None:
        self._ffi, self._lib = library()
        self.client = Client(mode, check, nonce, Feedback, Wheels)
        self.model = HostModel(mode, check, nonce, _LOG if logs else None)
        self._logs = self._ffi.new("uint8_t[]", _LOG), self._ffi.new("uint8_t[]", _LOG)
        kept = self._logs if logs else (self._ffi.NULL, self._ffi.NULL)
        self._lib.wheel_client_log(self.client.handle, *kept, _LOG)
        self.calls = 0
        self._compare("begin")

    def call(self, name: str, model: Callable[..., Any], *arguments: Any) -> Any:
        """Call ``wheel_client_NAME`` and the model's function; compare their results and all visible state."""
        self.calls += 1
        got, expected = getattr(self._lib, f"wheel_client_{name}")(self.client.handle, *arguments), model(*arguments)
        assert expected is None or got == expected, f"call {self.calls}, {name}{arguments}: {got} instead of {expected}"
        self._compare(f"{name}{arguments}")
        return expected

    def wish(self, request: Request, now_ns: int) -> None:
        """Have the heartbeats ask for it."""
        self.call("request", lambda wish, at: self.model.wish(Request(wish), at), int(request), now_ns)

    def command(self, speeds: Sequence[float], torques: Sequence[float], now_ns: int) -> None:
        """Add a command, by the call of a tick."""
        self.calls += 1
        got = self.client.command(tuple(speeds), tuple(torques), now_ns)  # type: ignore[arg-type]
        expected = self.model.command(speeds, torques, now_ns)
        assert got == expected, f"call {self.calls}: command {got} instead of {expected}"
        self._compare(f"command {speeds}, {torques}")

    def add(self, frame: Frame) -> None:
        """Add a message of another kind."""
        model = self.model.add
        self.call("add", lambda number, payload, _length: model(Frame(number, payload)), *frame, len(frame.payload))

    def wire(self, wires: Sequence[tuple[int, int]]) -> None:
        """Say which wheel each channel drives, and which way; a wrong wiring changes nothing."""
        wheels, signs = zip(*wires, strict=True)

        def model(_wheels: object, _signs: object) -> bool:
            is_one = sorted(wheels) == [0, 1, 2, 3] and {*signs} <= {1, -1}
            self.model.snapshots.wires = list(wires) if is_one else self.model.snapshots.wires
            return is_one

        self.call("wire", model, wheels, signs)

    def expect(self, check: int) -> None:
        """Say which check of the parameters the robot has to have."""
        self.model.check = check
        self.call("expect", lambda _check: None, check)

    def take(self, frames: Sequence[Frame], now_ns: int, cut: bytes = b"") -> None:
        """Take frames that arrive together; ``cut``: bytes of half a frame behind them."""
        data, left = pack(frames) + cut, list(frames)
        at = 0
        while left:
            self.calls += 1
            count, stopped, message = self.model.take(left, now_ns)
            end = at + len(pack(left[:count]))
            expected = end if stopped else len(data)
            got = self.client.take(data, at, now_ns)
            assert got == expected, f"call {self.calls}: it took {frames} to {got} instead of {expected}"
            told = None if message is None else message.ID
            view = self.client.view
            assert (view.message_id or None) == told, f"call {self.calls}: it told {view.message_id} and not {told}"
            if told is not None:
                assert view.message_at == end - len(pack(left[count - 1 : count])), f"call {self.calls}: message_at"
            self._compare(f"take {left[:count]}")
            if count == 0:
                self.send()
                self.take_logs()
            at, left = end, left[count:]

    def send(self) -> list[Frame]:
        """Send what waits; return it."""
        frames = [one.frame for one in self.model.waiting]
        count = self.client.sent()
        assert count == len(frames), f"call {self.calls}: {count} frames sent, expected {len(frames)}"
        self.model.send()
        self._compare("sent")
        return frames

    def take_logs(self) -> None:
        """Compare the logs, and empty them. No frame may wait."""
        before = [bytes(log) for log in self.model.logs]
        sizes = self._ffi.new("size_t[2]")
        self._lib.wheel_client_log_take(self.client.handle, sizes)
        assert tuple(sizes) == self.model.take_logs(), f"call {self.calls}: sizes of the logs {tuple(sizes)}"
        for log, size, expected in zip(self._logs, sizes, before, strict=True):
            assert bytes(self._ffi.buffer(log, size)) == expected, f"call {self.calls}: what is logged"
        self._compare("log_take")

    def _compare(self, after: str) -> None:
        view, model = self.client.view, self.model
        shown = [(name, getattr(view, name), getattr(model.snapshots, name)) for name in _OF_SNAPSHOT]
        shown += [(name, getattr(view, name), getattr(model, name)) for name in _OF_SESSION]
        for name, got, expected in shown:
            got = list(got) if isinstance(expected, list) else got
            assert repr(_plain(got)) == repr(_plain(expected)), (
                f"call {self.calls}, {after}: {name} {got}, not {expected}"
            )
        waiting = [one.frame for one in model.waiting]
        bytes_out = pack(waiting)
        out = bytes(self._ffi.buffer(self._lib.wheel_client_out(self.client.handle), view.out_bytes))
        assert out == bytes_out, f"call {self.calls}, {after}: {out.hex()} waits instead of {waiting}"
        serial = sum(7 + len(frame.payload) + (frame.id == 0x10) for frame in waiting)
        sizes = (view.out_frames, view.out_serial_bytes, view.round_trips)
        assert sizes == (len(waiting), serial, len(model.round_trips_ns)), f"call {self.calls}, {after}: {sizes}"
        if model.round_trips_ns:
            assert view.round_trip_ns == model.round_trips_ns[-1], f"call {self.calls}, {after}: round trip"
            newest = self.client.round_trips_ns(0)
            assert newest == model.round_trips_ns[-256:], f"call {self.calls}, {after}: round trips"


def _plain(value: Any) -> Any:
    """Return numbers as they compare: -0 as 0, enums as their value, but NaN as itself."""
    if isinstance(value, list):
        return [_plain(one) for one in value]
    return value + 0.0 if isinstance(value, float) else int(value)
