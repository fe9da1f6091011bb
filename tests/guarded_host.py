"""A host that drives a Rosmaster board over a port, guarded: for tests that kill it.

Says ``driving`` once the board has its command; every line that it is given then ends it: ``goodbye`` in order,
``raise`` by an exception.
"""

import sys

from firmware_protocol.framing import Frame
from hil.devices.guardian import Guardian
from hil.dialects.registry import dialect
from hil.links.serial_port import SerialStream

STOP = (Frame(0x12, bytes([1, 0, 0, 0, 0, 0, 0])), Frame(0x0F, b"\x5f"))
DRIVE = Frame(0x12, bytes.fromhex("01C80000000000"))  # 0.2 m/s forward


def encoded(*frames: Frame) -> bytes:
    """Return the bytes of frames on the board's line."""
    make = dialect("rosmaster").make_framing
    assert make is not None
    framing = make()
    return b"".join(map(framing.encode, frames))


def main(port: str) -> None:
    guardian = Guardian(port, 115200, encoded(*STOP))
    assert guardian.is_watching
    stream = SerialStream(port, 115200)
    stream.write(encoded(DRIVE))
    print("driving", guardian.pid, flush=True)
    word = sys.stdin.readline().strip()
    if word == "raise":
        raise RuntimeError("nobody catches this")
    stream.close()
    guardian.dismiss()
    guardian.dismiss()
    assert not guardian.is_watching


if __name__ == "__main__":
    main(*sys.argv[1:])
