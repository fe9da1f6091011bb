"""What foreign traffic on a CAN bus costs the host: ``python -m tools.bench.can_foreign``.

A bus of python-can's ``virtual`` interface is filled with frames of identifiers that are not ours. They are read by
python-can's own ``recv`` loop (the floor), by that loop with python-can's filters, and by ``CanLink``, which drops and
counts them. All ways run in turn, again and again; the numbers are medians of CPU time a frame. A frame that a kernel's
filter stops costs the host nothing.
"""

import argparse
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import can
from rich.console import Console
from rich.table import Table

from firmware_protocol.generated.messages import SENDERS, Tick
from hil.wire.can_bus import CanLink
from hil.wire.can_url import CanUrl

CHANNEL = "can_foreign"
FOREIGN = 0x555
LAST = can.Message(arbitration_id=Tick.ID, is_extended_id=False, data=bytes(Tick.LENGTH))
OURS = [number for number, sender in SENDERS.items() if sender == "ROBOT"]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="tools.bench.can_foreign", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--frames", type=int, default=5000, help="frames a repetition")
    parser.add_argument("--repeats", type=int, default=11, help="repetitions, of which the median counts")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
    options = parser.parse_args()
    rows: list[can.typechecking.CanFilter] = [
        {"can_id": number, "can_mask": 0x7FF, "extended": False} for number in OURS
    ]
    link = CanLink(CanUrl("virtual", CHANNEL), "ROBOT")
    with (
        can.Bus(interface="virtual", channel=CHANNEL) as plain,
        can.Bus(interface="virtual", channel=CHANNEL, can_filters=rows) as filtered,
        can.Bus(interface="virtual", channel=CHANNEL) as stranger,
    ):
        ways: dict[str, Callable[[], None]] = {
            "python-can, recv loop": lambda: _drain(plain),
            "python-can, recv loop with filters": lambda: _drain(filtered),
            "CanLink.receive": lambda: _drain_link(link),
        }
        costs: dict[str, list[float]] = {name: [] for name in ways}
        for _ in range(options.repeats):
            for _ in range(options.frames):
                stranger.send(can.Message(arbitration_id=FOREIGN, is_extended_id=False, data=bytes(8)))
            stranger.send(LAST)
            for name, drain in ways.items():
                begin_ns = time.process_time_ns()
                drain()
                costs[name].append((time.process_time_ns() - begin_ns) * 1e-3 / options.frames)
    assert link.rejected()["unknown_id"] == options.frames * options.repeats
    link.close()
    medians = {name: statistics.median(samples) for name, samples in costs.items()}
    _print(medians)
    if options.json is not None:
        floor = medians["python-can, recv loop"]
        figures = {name: {"cpu_us": median, "of_recv_loop": median / floor} for name, median in medians.items()}
        options.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")


def _drain(bus: can.BusABC) -> None:
    """Read to the frame of ours that ends a repetition."""
    while (message := bus.recv(1.0)) is not None:
        if message.arbitration_id == LAST.arbitration_id:
            return
    raise AssertionError("the last frame did not come")


def _drain_link(link: CanLink) -> None:
    received = link.receive(1_000_000_000)
    if received is None or received.frames[-1].id != LAST.arbitration_id:
        raise AssertionError("a foreign frame was taken for ours, or the last frame did not come")


def _print(medians: dict[str, float]) -> None:
    table = Table(title="a foreign frame, CPU time")
    for heading in ("way", "µs", "ratio"):
        table.add_column(heading, justify="left" if heading == "way" else "right")
    floor = next(iter(medians.values()))
    for name, median in medians.items():
        table.add_row(name, f"{median:.2f}", f"{median / floor:.2f}")
    Console().print(table)


if __name__ == "__main__":
    main()
