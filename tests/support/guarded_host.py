"""A host that drives a Rosmaster board over a port, guarded: for tests that stop and kill it.

Says ``driving`` and the guardian's process id once the board has its command, and ``told`` with the guardian's reason
when it must not drive on. Each line of its input is an order: ``goodbye`` ends it normally, ``raise`` by an exception.
``busy`` and a number keep it from commanding for that many seconds, ``lost`` says that its link is lost, ``arm`` begins
again.
"""

import select
import sys
import time

from firmware_protocol.framing import Frame
from hil.addons.motors.guardian import Guardian
from hil.robot.driver_registry import dialect
from hil.wire.serial_port import SerialStream

STOP = (Frame(0x12, bytes([1, 0, 0, 0, 0, 0, 0])), Frame(0x0F, b"\x5f"))
DRIVE = Frame(0x12, bytes.fromhex("01C80000000000"))  # 0.2 m/s forward
PERIOD_S = 0.01


def encoded(*frames: Frame) -> bytes:
    """Return the bytes of frames on the board's line."""
    make = dialect("rosmaster").make_framing
    assert make is not None
    framing = make()
    return b"".join(map(framing.encode, frames))


def arm(guardian: Guardian, stream: SerialStream) -> None:
    while not guardian.begin():
        time.sleep(PERIOD_S)
    stream.write(encoded(DRIVE))
    guardian.beat()
    print("driving", guardian.pid, flush=True)


def main(port: str, silence_s: str) -> None:
    guardian = Guardian(port, 115200, encoded(*STOP), silence_s=float(silence_s))
    stream = SerialStream(port, 115200)
    arm(guardian, stream)
    is_driving = True
    while True:
        if select.select([sys.stdin], [], [], PERIOD_S)[0]:
            order, *words = sys.stdin.readline().split()
            match order:
                case "raise":
                    raise RuntimeError("nobody catches this")
                case "busy":
                    time.sleep(float(words[0]))
                    print("done", flush=True)
                case "arm":
                    arm(guardian, stream)
                    is_driving = True
                case "lost":
                    guardian.hold()
                    is_driving = False
                case "goodbye":
                    break
        if is_driving and guardian.failure is not None:
            is_driving = False
            stream.write(encoded(*STOP))
            print("told", guardian.failure, flush=True)
        if is_driving:
            stream.write(encoded(DRIVE))
            guardian.beat()
    stream.close()
    guardian.rest()
    guardian.release()
    guardian.release()


if __name__ == "__main__":
    main(*sys.argv[1:])
