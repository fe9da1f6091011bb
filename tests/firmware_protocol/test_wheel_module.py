"""The extension module: what its calls return, and a sentence for what is no argument of theirs."""

import gc
import math
import os
import subprocess
import sys
import sysconfig
from array import array
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.built import HERE, SUFFIX
from firmware_protocol.client import Client
from firmware_protocol.codec import encode
from firmware_protocol.extension import library, wheel
from firmware_protocol.framer import Framer
from firmware_protocol.framing import Frame, pack
from firmware_protocol.generated import messages as m
from firmware_protocol.host_line import HostLine, PackedFrames
from hil.core import tuples
from hil.core.signals import LoopSignals
from hil.core.types import (
    ZERO_WHEELS,
    Acceleration,
    Applied,
    Axes,
    CommandMode,
    Pose,
    PoseFix,
    Reference,
    State,
    Twist,
    WheelCommand,
    Wheels,
)
from hil.robot.snapshot import Feedback
from hil.runtime.row import Scaled, row_of
from tests.support.client_rig import feed, feedback, kept_bytes, new_client, sent
from tests.support.wheel_rig import WheelRig
from tools.build import wheel_host
from tools.build.compiler import compiler

FOUR = (1.0, -2.0, 3, 4.5)
SNAPSHOT = (
    m.Tick(5_000, 3, 7, m.State.ACTIVE, 31, 1),
    m.Encoders(1, 2, 3, 4),
    m.WheelSpeeds(0.1, 0.2, 0.3, 0.4),
    m.Currents(1.0, 2.0, 3.0, 4.0),
    m.Accelerometer(0.5, 0.25, 9.75, 5),
    m.Gyro(0.0, 0.0, 0.125, 5),
)


def a_robot_in(state: m.State) -> Client:
    """Return a client that has one snapshot, of all parts."""
    client = new_client()
    feed(client, [SNAPSHOT[0]._replace(state=state), *SNAPSHOT[1:]])
    return client


def everything() -> dict[str, Any]:
    """Return an object of each type, the module, and named tuples that fit."""
    client, line = a_robot_in(m.State.ACTIVE), HostLine()
    direct = wheel.Direct(HostLine(), False)
    direct.listen(line)
    direct.serve(client)
    state = State(Pose(1.0, 2.0, 3.0), Twist(4.0, 5.0, 6.0))
    return {
        "client": client, "line": line, "direct": direct, "node": WheelRig(lockstep=True).node,
        "freshness": wheel.Freshness(50_000_000), "latency": wheel.Latency(0.5, 100_000_000, Applied),
        "motion": wheel.Motion(), "load": wheel.Load(1.0), "other": wheel.Load(1.0), "made": tuples._made,
        "tables": wheel.Tables(array("d", [1.0] * 130).tobytes()), "row": row_of("abcdefghij", {"a": ("a",)}, "abc"),
        "feedback": feedback(client), "state": state, "truth": PoseFix(1, *state), "wheel": wheel,
    }  # fmt: skip


# Each call of the module with arguments that it takes; `X` stands for one that is tried with what is none.
CALLS = (
    "client.poll(5)", "client.command((1., 2., 3., 4.), (1, 2, 3, 4), 5)", "client.take(b'', 0, 5)", "client.ask(1)",
    "line.receive_for(client, b'', 5)", "line.encode_for(client)", "direct.listen(line)", "direct.serve(client)",
    "direct.hold(node, b'')", "direct.exchange(node, 0)", "direct.step(node, 0, 5)",
    "freshness.add(feedback, truth, 0, 5, True)", "freshness.has_aged(5)", "freshness.begin_again(True)",
    "latency.applied(feedback, 1, 5, None, False)", "motion.add((1., 2., 3., 4.), 5, state, 0.1, 0.2)",
    "load.count(5, 1.0)", "load.count_both(other, 5, (1.0, 2.0))", "tables.look_up((1.0, 2.0))",
    "wheel.is_within((1., 2., 3., 4.), 5.0)", "wheel.is_finite(state)", "wheel.difference(state, state)",
    "wheel.wheel_torques((1., 2., 3.), (1., 2.), (1., 2., 3.), (1., 2., 3.), 0.5)",
    "wheel.split(b'', 3)", "made.pose_fix(bytes(56))",
)  # fmt: skip
OPAQUE = {("latency.applied", 3), ("latency.applied", 4), ("freshness.add", 1)}


@pytest.mark.parametrize("call", CALLS)
def test_each_call_refuses_what_it_does_not_take(call: str) -> None:
    names = everything()
    function, _, rest = call.partition("(")
    given = list(eval(f"({rest[:-1]},)", names))
    make = eval(function, names)
    make(*given)
    for wrong in (given[:-1], [*given, None]):
        with pytest.raises(TypeError, match="argument"):
            make(*wrong)
    for place in range(len(given)):
        if (function, place) in OPAQUE:
            continue
        before = sys.getrefcount(function)
        with pytest.raises((TypeError, ValueError)) as refused:
            make(*given[:place], function, *given[place + 1 :])
        assert len(str(refused.value)) > 10
        refused = None  # its frames hold the argument
        assert sys.getrefcount(function) == before


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: wheel.Client(1, 2), "takes exactly 6 arguments"),
        (lambda: wheel.Node(b"", None, 0, 0, 0, 0), "0 bytes of parameters"),
        (lambda: wheel.Direct(3, False), "expected a <class 'firmware_protocol._wheel.Line'>, not <class 'int'>"),
        (lambda: wheel.Tables(bytes(8)), "8 bytes of tables; expected 1040 each, of 4 at most"),
        (lambda: wheel.Row(("a",), (3,), bytes(24), (0, 0, 0)), "a row of 3 columns has no pose at 0"),
        (lambda: wheel.Row(("a",), ((0, 10),), bytes(80), (0, 3, 6)), "a row of 10 columns has no place 10"),
        (lambda: wheel.Client(1, 2, 3, 4, 5, 6), "expected a class of tuples, not 4"),
        (lambda: new_client(nonce=1 << 16), "a Client with nonce 65536; expected 0 to 65535"),
        (lambda: wheel.Latency(0.5, 1, int), "expected a class of tuples, not <class 'int'>"),
        (lambda: wheel.Tuples(*[Pose] * 8, 3, 4, 5, 6), "expected a class of tuples, not 3"),
        (lambda: wheel.frames(b"", 3), "expected a class of tuples, not 3"),
        (lambda: wheel.Row(("a",), ((0,) * 600,), bytes(80), (0, 3, 6)), "a row of more than 512 members"),
        (lambda: wheel.Row(("a",), (0,), bytes(80), (0, 3, 6)).make(b=1), "a row has no 'b'; expected some of"),
        (lambda: wheel.Row(("a",), (0,), bytes(80), (0, 3, 6)).make(1), "takes keyword arguments"),
        (lambda: wheel.Line.__new__(wheel.Line).encode_for(wheel.Client.__new__(wheel.Client)), "was not initialised"),
        (lambda: wheel.Direct(HostLine(), False).exchange(WheelRig().node, None), "call listen"),
        (lambda: tuples._made.pose_fix(bytes(7)), "has not 56 bytes"),
        (lambda: wheel.terminal_read(-1), "-1 is no descriptor"),
        (lambda: wheel.terminal_write(1 << 32, b""), "is no descriptor"),
        (lambda: new_client().take(b"", -1, 0), "expected 0 or more"),
        (lambda: new_client().poll(1 << 70), "too big"),
    ],
)
def test_what_fits_nowhere_is_told(make: Callable[[], object], words: str) -> None:
    with pytest.raises((TypeError, ValueError, RuntimeError, OverflowError)) as refused:
        make()
    assert words in str(refused.value)


def test_a_command_takes_numbers_of_any_kind() -> None:
    client = new_client()
    assert client.command(FOUR, (0, 0, 0, True), 0) == 1
    assert sent(client) == [m.TorqueFeedforward(0, 0, 0, 1, 1, 1), m.WheelCommand(*FOUR, 1, 1)]


NAMES = ("x", "y", "h", "to_x", "to_y", "to_h", "dx", "dy", "dh", "d", "a", "b")
DIFFERENCE = ("x", "to_x", "dx")
numbers = st.floats(allow_nan=False, allow_infinity=False, width=32)


@given(pose=st.tuples(numbers, numbers, numbers), to=st.tuples(numbers, numbers, numbers), a=numbers)
def test_a_row_has_each_number_in_its_place_and_the_difference_of_the_poses(pose: Axes, to: Axes, a: float) -> None:
    made = row_of(NAMES, {"scaled": Scaled("a", 0.5), "to": (NAMES[3:6], None), "at": NAMES[:3]}, DIFFERENCE)
    row = dict(zip(NAMES, memoryview(made.make(at=pose, to=(to, "left out"), scaled=a)).cast("d"), strict=True))
    x, y, h = (one - other for one, other in zip(pose, to, strict=True))
    assert [row[name] for name in NAMES[:9]] == [*pose, *to, x, y, math.remainder(h, math.tau)]
    assert row["d"] == pytest.approx(math.hypot(x, y), rel=1e-15)
    assert row["a"] == 0.5 * a
    assert math.isnan(row["b"]), "no object has it"
    again = memoryview(made.make(scaled=7.0)).cast("d")
    assert (list(again[:6]), again[10]) == ([*pose, *to], 3.5)


def test_an_infinite_heading_has_no_difference() -> None:
    made = row_of(NAMES, {"at": NAMES[:3], "to": NAMES[3:6]}, DIFFERENCE)
    row = memoryview(made.make(to=(0, 0, 0), at=(0, 0, math.inf))).cast("d")
    assert math.isnan(row[NAMES.index("dh")])


@pytest.mark.parametrize("wrong", [("a", 1), (1,), 1, None])
def test_what_has_not_the_layout_of_a_row_raises(wrong: object) -> None:
    made = row_of(NAMES, {"at": ("a", "b")}, DIFFERENCE)
    with pytest.raises(TypeError):
        made.make(at=wrong)


@given(some=st.lists(st.builds(Frame, st.integers(0, 0xFFFF), st.binary(max_size=255)), max_size=9))
def test_packed_frames_come_apart_as_they_were(some: list[Frame]) -> None:
    unpacked = list(PackedFrames(pack(some)))
    assert unpacked == some
    assert all(type(frame) is Frame for frame in unpacked)
    below, others = wheel.split(pack(some), 0x300)
    assert below == pack(frame for frame in some if frame.id < 0x300)
    assert others == pack(frame for frame in some if frame.id >= 0x300)


def test_noise_is_the_sum_of_what_is_rejected_but_for_lost_frames() -> None:
    line, framer = HostLine(), Framer()
    framer.encode(encode(m.Step(0, 1)))  # never comes
    whole = framer.encode(encode(m.StepDone(1)))
    line.feed(b"\2a\0".join((whole, whole[:3] + b"\1" + whole[4:], b"x" * 99, b"")))
    counts = line.rejected
    assert line.noise() == sum(counts.values()) - counts["lost"] > 2


some_frames = st.lists(
    st.sampled_from(
        [m.Tick(1000, 3, 7, m.State.ACTIVE, 1, 1), m.Encoders(1, 2, 3, 4), m.TimeSyncResponse(1, 2, 3), m.StepDone(7)]
    ).map(encode),
    max_size=12,
)


@given(frames=some_frames, noise=st.binary(max_size=20), cut=st.integers(0, 200))
def test_received_bytes_leave_a_client_as_their_frames_do(frames: list[Frame], noise: bytes, cut: int) -> None:
    here, packed_way = HostLine(), HostLine()
    at_once, one_by_one = new_client(), new_client()
    framer = Framer()
    data = noise + b"\0" + b"".join(framer.encode(frame) for frame in frames)
    for piece in (data[:cut], data[cut:]):
        taken = here.receive_for(at_once, piece, 5)
        packed = packed_way.feed(piece).packed
        if not isinstance(taken, int):
            rest, at = taken
            assert rest == packed
            while at < len(rest):
                at = at_once.take(rest, at, 5)
        at = 0
        while at < len(packed):
            at = one_by_one.take(packed, at, 5)
    assert (at_once.view.received, at_once.view.step_done_tick) == (
        one_by_one.view.received,
        one_by_one.view.step_done_tick,
    )
    assert at_once.hexdigest() == one_by_one.hexdigest()
    assert here.rejected == packed_way.rejected


def test_what_waits_is_encoded_as_a_line_does() -> None:
    here, packed_way, client = HostLine(), HostLine(), new_client()
    assert here.encode_for(client) == b""
    for _ in range(2):
        client.command(FOUR, FOUR, 0)
        client.estop()
        packed = client.out().packed
        assert here.encode_for(client) == packed_way.encode_packed(packed)
        assert client.sent() == 3
        assert here.encode_for(client) == b""


def test_what_is_due_is_added_when_all_was_taken() -> None:
    line, client = HostLine(), new_client()
    client.request(m.Request.IDLE, 0)
    client.sent()
    assert line.receive_for(client, b"", 99_999_999) == 0
    assert line.receive_for(client, b"", 100_000_000) == (b"", 0)
    assert [message.request for message in sent(client)] == [m.Request.IDLE]


def test_feedback_is_a_named_tuple_with_what_the_view_has() -> None:
    client = a_robot_in(m.State.ACTIVE)
    found = client.feedback()
    assert found == feedback(client)
    assert type(found) is Feedback
    assert (type(found.speed_rad_s), type(found.current_a), found.state) == (Wheels, Wheels, m.State.ACTIVE)
    assert new_client().feedback() is None
    few = wheel.Client(m.Mode.SPEED, 0x5A, 1, Feedback, Wheels, (m.State.BOOT,))
    few.take(pack([encode(one) for one in SNAPSHOT]), 0, 0)
    with pytest.raises(TypeError, match="expected a tuple of 4 items or more"):
        few.feedback()


@given(st.lists(st.sampled_from([0.0, -0.0, 1.5, float("nan"), float("inf")]), min_size=1, max_size=20))
def test_numbers_of_a_lower_rate_are_the_same_tuple_while_they_are_the_same(values: list[float]) -> None:
    client = a_robot_in(m.State.ACTIVE)
    ffi, held = library()[0], client.feedback().current_a
    before = bytes(ffi.buffer(client.view.current_a))
    for place, value in enumerate(values):
        client.view.current_a[place % 4] = value
        now, made = bytes(ffi.buffer(client.view.current_a)), client.feedback().current_a
        assert type(made) is Wheels
        assert list(map(repr, made)) == list(map(repr, client.view.current_a))
        assert (made is held) == (now == before)
        before, held = now, made


@given(st.tuples(*[st.floats()] * 6))
def test_a_state_is_finite_when_each_of_its_numbers_is(six: tuple[float, ...]) -> None:
    state = State(Pose(*six[:3]), Twist(*six[3:]))
    assert wheel.is_finite(state) == all(map(math.isfinite, six))


NINE = tuple(range(9))
SIX = array("d", [1.5, 2.5, 3.5, 4.5, 5.5, 6.5])
MADE: list[tuple[Callable[..., tuple], tuple, tuple]] = [
    (tuples.make_loop_signals, (1.0, 2, 3.0, 4.0, 5), LoopSignals(1.0, 2, 3.0, 4.0, 5)),
    (tuples.make_wheels, FOUR, Wheels(*FOUR)),
    (tuples.make_command, (CommandMode.SPEED, ZERO_WHEELS, FOUR), WheelCommand(CommandMode.SPEED, ZERO_WHEELS, FOUR)),
    (tuples.make_state, (Pose(1, 2, 3), Twist(4, 5, 6)), State(Pose(1, 2, 3), Twist(4, 5, 6))),
    (tuples.make_reference, NINE, Reference(Pose(0, 1, 2), Twist(3, 4, 5), Acceleration(6, 7, 8))),
    (tuples.make_pose_fix, (array("q", [-7]).tobytes() + SIX.tobytes(),), PoseFix(-7, Pose(*SIX[:3]), Twist(*SIX[3:]))),
    (tuples.make_torque_command, FOUR, WheelCommand(CommandMode.TORQUE, ZERO_WHEELS, Wheels(*FOUR))),
    (tuples.make_speed_command, (*FOUR, *NINE[:4]), WheelCommand(CommandMode.SPEED, Wheels(*FOUR), Wheels(*NINE[:4]))),
]


def types_in(value: object) -> object:
    """Return the class of a value, with those in a tuple."""
    return (type(value), *map(types_in, value)) if isinstance(value, tuple) else type(value)


@pytest.mark.parametrize(("make", "arguments", "expected"), MADE)
def test_what_is_made_is_what_its_classes_make(make: Callable[..., tuple], arguments: tuple, expected: tuple) -> None:
    made = make(*arguments)
    assert (made, types_in(made)) == (expected, types_in(expected))
    for wrong in (arguments[1:], (*arguments, 0.0)):
        with pytest.raises(TypeError, match="argument"):
            make(*wrong)
    seen = (*arguments, ZERO_WHEELS, CommandMode.TORQUE, Pose, Wheels)
    before = [sys.getrefcount(one) for one in seen]
    for _ in range(1000):
        make(*arguments)
    assert all(sys.getrefcount(one) < count + 100 for one, count in zip(seen, before, strict=True))


def test_a_thousand_calls_leave_no_object_behind() -> None:
    client, line, framer = a_robot_in(m.State.ACTIVE), HostLine(), Framer()
    data, packed = framer.encode(encode(m.TimeSyncResponse(1, 2, 3))), pack([Frame(0x100, bytes(8)), Frame(0x300, b"")])
    row = row_of(NAMES, {"one": "a", "two": (None, Scaled("b", 2.0))}, DIFFERENCE)
    seen = (data, packed, *m.State, None, Feedback, Wheels)
    gc.collect()  # what other tests have left may hold some of these
    references = [sys.getrefcount(one) for one in seen]

    def calls() -> None:
        assert not isinstance(line.receive_for(client, data, 0), int)
        client.hash_log()
        assert client.feedback().command_age_ms == 7
        assert row.make(one=1, two=(0, 3)) == row.make(two=("left out", True + 2), one=1.0)
        assert wheel.split(packed, 0x300) == (packed[:11], packed[11:])
        assert PackedFrames(packed)[1] == Frame(0x300, b"")

    assert kept_bytes(calls) < 10_000
    gc.collect()
    grown = [sys.getrefcount(one) for one in seen]
    assert all(abs(now - before) < 100 for now, before in zip(grown, references, strict=True))


def test_what_calls_leave_behind_is_seen() -> None:
    left: list[bytes] = []
    assert kept_bytes(lambda: left.append(bytes(len(left)))) > 500_000


def test_an_object_that_cannot_be_initialised_again_is_as_it_was() -> None:
    names = everything()
    client, direct, made = names["client"], names["direct"], tuples._made
    before = client.feedback(), made.wheels(*FOUR)
    for again, wrong in (
        (wheel.Client.__init__, (client, 0, 0, 0, *map(str, range(1000, 1003)))),
        (wheel.Direct.__init__, (direct, str(1003), False)),
        (wheel.Tuples.__init__, (made, Pose, str(1004), *[Pose] * 10)),
        (wheel.Latency.__init__, (names["latency"], 0.5, 1, str(1005))),
    ):
        with pytest.raises(TypeError):
            again(*wrong)
    assert (client.feedback(), made.wheels(*FOUR)) == before
    assert type(direct.exchange(names["node"], 0)) is bytes
    assert type(names["latency"].applied(names["feedback"], 1, 5, None, False)) is Applied


def test_objects_free_what_they_hold() -> None:
    for make in (lambda: everything(), lambda: a_robot_in(m.State.IDLE).feedback()):
        make()
        before = sys.getrefcount(Feedback), sys.getrefcount(wheel.Line), sys.getrefcount(Applied)
        for _ in range(200):
            make()
        after = sys.getrefcount(Feedback), sys.getrefcount(wheel.Line), sys.getrefcount(Applied)
        assert max(now - then for now, then in zip(after, before, strict=True)) < 50


def test_each_call_has_a_docstring_and_a_line_in_the_stub() -> None:
    stub = Path(sys.modules[wheel.__name__].__file__ or "").with_name("_wheel.pyi").read_text(encoding="utf-8")
    for name, one in vars(wheel).items():
        if name.startswith("_"):
            continue
        assert one.__doc__, name
        assert f"def {name}(" in stub or f"class {name}:" in stub, name
        for method, function in vars(one).items() if isinstance(one, type) else ():
            if not method.startswith("_"):
                assert function.__doc__, f"{name}.{method}"
                assert f"def {method}(" in stub or f"    {method}: " in stub, f"{name}.{method}"


PYTHON_H = Path(sysconfig.get_path("include"), "Python.h")


@pytest.mark.skipif(not PYTHON_H.is_file(), reason="no Python.h; on Debian: apt install python3-dev")
@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("", "", ""),
        ("PyTuple_SetItem(PyObject *, Py_ssize_t,", "PyTuple_SetItem(PyObject *, int,", "PyTuple_SetItem"),
        ("#define Py_tp_init 60", "#define Py_tp_init 61", "Py_tp_init"),
        ("    int basicsize;", "    long basicsize;", "PyType_Spec"),
        ("    Py_ssize_t offset;", "    int offset;", "PyMemberDef"),
    ],
)
def test_the_header_of_the_stable_abi_agrees_with_the_real_one(
    before: str, after: str, said: str, tmp_path: Path
) -> None:
    text = (HERE / "port" / "python" / "stable_abi.h").read_text(encoding="utf-8")
    assert before in text
    (tmp_path / "stable_abi.h").write_text(text.replace(before, after, 1), encoding="utf-8")
    include = (f"-I{tmp_path}", f"-I{PYTHON_H.parent}")
    check = Path(__file__).with_name("stable_abi_check.c")
    command = [*compiler(), "-std=c11", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", *include, str(check)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode == 0) == (not said), done.stderr
    assert said in done.stderr


def test_a_program_in_c_links_a_library_without_python(tmp_path: Path) -> None:
    program = tmp_path / "main.c"
    program.write_text(
        '#include "client/wheel_client.h"\n#include "port/host/host.h"\n'
        "int main(void) { return wheel_client_size() == sizeof(wheel_client) && wheel_host_size() > 0 ? 7 : 1; }\n"
    )
    library = wheel_host.build_for_c(tmp_path / f"libwheel{SUFFIX}")
    out = tmp_path / "main"
    command = [*compiler(), f"-I{HERE}", str(program), str(library), f"-Wl,-rpath,{tmp_path}", "-o", str(out)]
    subprocess.run(command, check=True)
    assert subprocess.run([str(out)], check=False).returncode == 7


def test_a_python_without_a_gil_is_refused_in_a_sentence() -> None:
    program = """
import sysconfig
real = sysconfig.get_config_var
sysconfig.get_config_var = lambda name: 1 if name == "Py_GIL_DISABLED" else real(name)
import hil.core.tuples as t
t.make_wheels(1.0, 2.0, 3.0, 4.0)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert "BadInputError: this Python has no GIL, and the extension module needs one; use the usual" in done.stderr


def test_without_the_module_only_what_needs_it_is_refused(tmp_path: Path) -> None:
    """Whatever needs no run, such as ``hil doctor``, works then. It is another process because of the import."""
    missing = tmp_path / "missing"
    program = "import hil.laws, hil.core.tuples as t; print('imported'); t.make_wheels(1.0, 2.0, 3.0, 4.0)"
    environment = os.environ | {"WHEEL_HOST_LIBRARY": str(missing)}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=False)
    assert done.stdout == "imported\n"
    assert f"BadInputError: {missing} does not exist; build it, or unset WHEEL_HOST_LIBRARY" in done.stderr
