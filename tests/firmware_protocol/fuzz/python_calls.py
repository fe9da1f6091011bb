"""Fuzzes the calls of the extension module: any values, in any order, to a module under ASan and UBSan.

``tools.fuzz`` runs this in a process of its own, with the sanitised library in ``WHEEL_HOST_LIBRARY``. A call returns
or raises, and keeps no reference to what it got.
"""

import argparse
import contextlib
import functools
import os
import sys
from array import array
from collections.abc import Callable
from typing import Any, NamedTuple, cast

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from firmware_protocol.extension import library, wheel
from firmware_protocol.framer import Framer
from firmware_protocol.framing import Frame, pack
from firmware_protocol.generated import messages as m
from firmware_protocol.host_line import HostLine
from hil.core import tuples
from hil.core.types import ZERO_WHEELS, Applied, CommandMode, Pose, Reference, State, Twist, Wheels
from hil.robot.direct import DirectLink, LibraryRobot
from hil.runtime.row import Scaled, row_of
from hil.wire.streams import DirectStream
from tests.support.client_rig import new_client
from tests.support.protocol_cases import frames as some_frame
from tests.support.wheel_rig import WheelRig

RAISED = (TypeError, IndexError, OverflowError, ValueError)
_DAY_NS = 86_400_000_000_000


class Number:
    """Something that converts to a number, or raises while it does."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def __float__(self) -> float:
        return float(self._converted())

    def __index__(self) -> int:
        return int(self._converted())

    def _converted(self) -> Any:
        if self.value is None:
            raise ValueError("no number")
        return self.value


class Words(bytes):
    """Bytes of a class of its own."""


floats = st.floats() | st.sampled_from([0.0, -1.0, 1.0, 5e-324, 1e308])
# Times are some days at most: further ones, which no clock here has, may overflow when they are subtracted.
ints = st.integers(-2, 1001) | st.sampled_from([-(1 << 70), -1 << 40, 1 << 31, 1 << 64])
times = st.integers(-_DAY_NS, _DAY_NS) | st.sampled_from([-1, 0, 1_000_000])
one = st.builds(Number, st.none() | st.integers(-3, 3) | st.just(-1.0))
any_number = floats | ints | st.booleans() | one
packed = st.lists(some_frame, max_size=6).map(pack)
framed = st.lists(some_frame, max_size=6).map(lambda some: b"".join(map(Framer().encode, some)))
any_bytes = packed | framed | st.binary(max_size=40) | st.builds(Words, packed) | st.just(pack([Frame(3, b"")] * 2000))
atoms = any_number | any_bytes | st.none() | st.text(max_size=3)


def four_of(number: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    """Return tuples of about four numbers, and what is none."""
    right = st.tuples(number, number, number, number).map(lambda four: Wheels(*four))
    return right | st.lists(number, max_size=5).map(tuple) | st.just([1.0] * 4)


axes = st.tuples(any_number, any_number, any_number) | st.lists(any_number, max_size=2).map(tuple)
motion = st.tuples(axes.map(tuple), axes) | st.tuples(axes, axes, axes) | st.just(())
nested = st.recursive(atoms, lambda inner: st.lists(inner, max_size=5).map(tuple), max_leaves=12)


def mostly(right: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    """Return what an argument should be, and now and then anything."""
    return st.integers(0, 7).flatmap(lambda turn: nested if turn == 0 else right)


class Call(NamedTuple):
    """A function of the rig by name, and what it is called with."""

    name: str
    arguments: tuple[Any, ...]


def call(name: str, *arguments: st.SearchStrategy[Any]) -> st.SearchStrategy[Call]:
    return st.tuples(*map(mostly, arguments)).map(lambda given: Call(name, given))


@functools.cache
def descriptors() -> tuple[Any, ...]:
    """Return both ends of a pipe, and values that are no descriptor: any other number may be open in this process."""
    ends = os.pipe()
    for end in ends:
        os.set_blocking(end, False)
    return (*ends, *(end + (1 << 32) for end in ends), -1, 1 << 31, -1 << 70, None, "1", 1.0, Number(None))


descriptor = st.integers(0, 10).map(lambda place: descriptors()[place])
feedback = st.tuples(times, st.integers(0, 8), st.integers(0, 255), st.integers(0, 255))
truth = st.none() | st.tuples(times, axes, axes)
calls = st.one_of(
    call("command", four_of(any_number), four_of(any_number), times),
    call("poll", times),
    call("take", any_bytes, st.integers(-3, 30), times),
    call("receive", any_bytes, times),
    call("encode"),
    call("out"),
    call("sent"),
    call("ask", st.integers(-1, 70_000)),
    call("link_figures"),
    call("read_feedback"),
    call("step", st.integers(-1, 1001), times),
    call("hold", packed),
    call("exchange", st.integers(-1, 1001)),
    call("crossed"),
    call("line_bytes"),
    call("noise"),
    call("add_feedback", feedback, truth, times, times, st.booleans()),
    call("begin_again", st.booleans()),
    call("applied", feedback, ints, times, atoms, st.booleans()),
    call("add_motion", four_of(any_number), times, motion, any_number, any_number),
    call("has_aged", times),
    call("count_load", times, any_number),
    call("count_loads", times, st.tuples(any_number, any_number)),
    call("split", any_bytes, ints),
    call("finite", motion),
    call("within", four_of(any_number), any_number),
    call("frames", any_bytes),
    call("difference", motion, motion),
    call("wheel_torques", axes, st.tuples(any_number, any_number), axes, axes, any_number),
    call("row", axes, motion, any_number),
    call("look_up", st.tuples(*[any_number] * 4)),
    call("make_state", axes, axes),
    call("make_reference", *[any_number] * 9),
    call("make_pose_fix", st.binary(min_size=56, max_size=56) | any_bytes),
    call("new_client", st.integers(-1, 300), st.integers(-1, 300), ints, nested, nested, nested),
    call("new_row", nested, nested, any_bytes, nested),
    call("new_tables", any_bytes),
    call("new_direct", nested, nested),
    call("new_latency", any_number, times, nested),
    call("new_tuples", *[nested] * 12),
    call("hash_log"),
    st.builds(Call, st.just("terminal_read"), st.tuples(descriptor)),
    st.builds(Call, st.just("terminal_write"), st.tuples(descriptor, mostly(any_bytes))),
)


class Rig:
    """All that the functions belong to: a client, both ends of its line, a robot in this thread, times and tables."""

    def __init__(self, mode: m.Mode) -> None:
        ffi, _ = library()
        self.client = client = new_client(mode)
        self.rig = WheelRig(lockstep=True)
        self.line = line = HostLine()
        self.direct = DirectLink(cast(LibraryRobot, self.rig), DirectStream(lambda _: b""))
        self.direct.serve(client)
        ages, latency, motion = wheel.Freshness(50_000_000), wheel.Latency(0.0, 100_000_000, Applied), wheel.Motion()
        moves = ffi.cast("wheel_motion *", motion.address)
        moves.wheel_radius_m, moves.lever_m, moves.ahead_s, moves.lag_s = 0.075, 0.6, 0.01, 0.01
        load, other = wheel.Load(0.1), wheel.Load(0.2)
        table = [1.0, 1.0, *range(8 * 16)]
        tables = wheel.Tables(array("d", table + table).tobytes())
        objects = {"at": ("x", "y", "h"), "to": (("to_x", "to_y", "to_h"), None), "last": Scaled("last", 2.0)}
        names = ("x", "y", "h", "to_x", "to_y", "to_h", "dx", "dy", "dh", "d", "last")
        row = row_of(names, objects, ("x", "to_x", "dx"))
        robot, held = self.rig.node, self.direct._line
        self.functions: dict[str, Callable[..., Any]] = {
            "command": client.command,
            "poll": client.poll,
            "take": client.take,
            "receive": lambda data, now_ns: line.receive_for(client, data, now_ns),
            "encode": lambda: line.encode_for(client),
            "out": client.packed,
            "sent": client.sent,
            "ask": client.ask,
            "link_figures": client.link_figures,
            "read_feedback": client.feedback,
            "step": lambda ticks, now_ns: held.step(robot, ticks, now_ns),
            "hold": lambda data: held.hold(robot, data),
            "exchange": lambda ticks: held.exchange(robot, ticks),
            "crossed": held.crossed,
            "line_bytes": held.line_bytes,
            "noise": line.noise,
            "add_feedback": ages.add,
            "begin_again": ages.begin_again,
            "applied": latency.applied,
            "add_motion": motion.add,
            "has_aged": ages.has_aged,
            "count_load": load.count,
            "count_loads": lambda now_ns, both: load.count_both(other, now_ns, both),
            "split": wheel.split,
            "finite": wheel.is_finite,
            "within": wheel.is_within,
            "frames": lambda data: wheel.frames(data, Frame),
            "difference": wheel.difference,
            "wheel_torques": wheel.wheel_torques,
            "row": lambda at, to, last: row.make(at=at, to=to, last=last),
            "look_up": tables.look_up,
            "make_state": tuples.make_state,
            "make_reference": tuples.make_reference,
            "make_pose_fix": tuples.make_pose_fix,
            "new_client": wheel.Client,
            "new_row": wheel.Row,
            "new_tables": wheel.Tables,
            "new_direct": wheel.Direct,
            "new_latency": wheel.Latency,
            "new_tuples": wheel.Tuples,
            "hash_log": client.hash_log,
            "terminal_read": wheel.terminal_read,
            "terminal_write": wheel.terminal_write,
        }


# Objects that the functions hand on or name: none may be kept, or given away.
SEEN = (Frame, Wheels, Pose, Twist, State, Reference, ZERO_WHEELS, CommandMode.TORQUE)


def own_of(arguments: tuple[Any, ...]) -> list[Any]:
    """Return the objects in arguments that have no other owner: CPython shares small numbers and empty objects."""
    inner = [one for argument in arguments if isinstance(argument, tuple) for one in own_of(argument)]
    return inner + [
        one for one in arguments if isinstance(one, (Number, tuple, bytes)) and (type(one) is Number or one)
    ]


def perform(rig: Rig, sequence: list[Call]) -> None:
    """Make the calls; each returns, or raises what CPython raises for such arguments."""
    for name, arguments in sequence:
        own = own_of(arguments)
        before = [sys.getrefcount(argument) for argument in own]
        with contextlib.suppress(*RAISED):
            rig.functions[name](*arguments)
        after = [sys.getrefcount(argument) for argument in own]
        assert after == before, f"{name} kept or gave away a reference to {arguments}"
        view = rig.client.view
        assert view.out_bytes <= library()[1].WHEEL_CLIENT_OUT


def main() -> None:
    """Make so many sequences of calls."""
    parser = argparse.ArgumentParser(
        prog="tests.firmware_protocol.fuzz.python_calls", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--runs", type=int, default=500, help="sequences of calls")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    made = 0

    @seed(options.seed)
    @settings(
        max_examples=options.runs,
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(st.sampled_from(m.Mode), st.lists(calls, min_size=10, max_size=60))
    def run(mode: m.Mode, sequence: list[Call]) -> None:
        nonlocal made
        made += len(sequence)
        perform(Rig(mode), sequence)

    before = [sys.getrefcount(one) for one in SEEN]
    run()
    for one, then in zip(SEEN, before, strict=True):
        kept = sys.getrefcount(one) - then
        assert abs(kept) < max(20, made // 100), f"{kept} references to {one} are left, or too few"
    print(f"{options.runs} sequences, {made} calls")


if __name__ == "__main__":
    main()
