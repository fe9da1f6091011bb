"""Another device on the bus, which knows nothing of ours: ``python foreign_traffic.py INTERFACE``.

Its pace is the bus's own: it answers every frame that it sees with one of another kind each time. Prints ``ready``,
and on SIGTERM how many it has sent of each kind.
"""

import itertools
import json
import signal
import socket
import struct
import sys

_EXTENDED, _REMOTE = 0x80000000, 0x40000000
_WHEEL_COMMAND, _TICK = 0x040, 0x080


def main() -> None:
    """Answer until SIGTERM."""
    bus = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    bus.bind((sys.argv[1],))
    kinds = {
        "unknown": (0x123, bytes(8)),
        "extended": (_EXTENDED | _WHEEL_COMMAND, bytes(8)),
        "extended_j1939": (_EXTENDED | 0x18FEF100, bytes(range(8))),
        "remote": (_REMOTE | _TICK, bytes(8)),
        "short_command": (_WHEEL_COMMAND, bytes(3)),
        "short_tick": (_TICK, bytes(7)),
        "highest": (0x7FF, b""),
    }
    sent = dict.fromkeys(kinds, 0)

    def end(_number: int, _frame: object) -> None:
        print(json.dumps(sent), flush=True)
        sys.exit()

    signal.signal(signal.SIGTERM, end)
    print("ready", flush=True)
    for name in itertools.cycle(kinds):
        bus.recv(16)
        can_id, payload = kinds[name]
        bus.send(struct.pack("=IB3x8s", can_id, len(payload), payload))
        sent[name] += 1


if __name__ == "__main__":
    main()
