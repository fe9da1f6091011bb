"""Traces for tests: of a short run, and of a bus with somebody else on it."""

import can

from firmware_protocol import codec
from firmware_protocol.generated import messages as m
from hil.runtime.assembly import run

SHORT = {"loop.duration_s": 0.15, "expect": []}


def traced(path, link="memory:", **options):
    result = run("paper_circle", set=SHORT | options, mode="lockstep", link=link, trace=path)
    assert result.failure is None
    return result


def one_second_of_frames():
    """What a bus with somebody else on it carries."""
    command = codec.encode(m.WheelCommand(1.5, -2.25, 10.0, 0.015625, 17, 5))
    tick = codec.encode(m.Tick(1_234_567, 17, 3, m.State.ACTIVE, 3, 200))
    status = codec.encode(m.Status(m.State.FAULT, 0, m.Fault.OVERCURRENT, m.FaultWheel.RR, 5, 1, 0x1235, 0, 12))
    yield can.Message(1.7e9, command.id, False, data=command.payload, is_rx=False)
    yield can.Message(1.7e9 + 0.005, tick.id, False, data=tick.payload)
    yield can.Message(1.7e9 + 0.006, 0x18FF1234, True, data=b"\1\2\3")
    yield can.Message(1.7e9 + 0.007, 0x123, False, data=b"")
    yield can.Message(1.7e9 + 0.008, tick.id, False, data=b"\1\2")
    yield can.Message(1.7e9 + 0.009, status.id, False, data=b"\x0f" * 8)
    yield can.Message(1.7e9 + 0.010, 0x080, False, is_remote_frame=True, dlc=8)
    yield can.Message(1.7e9 + 0.011, is_error_frame=True)
    yield can.Message(1.7e9 + 1.0, status.id, False, data=status.payload)
