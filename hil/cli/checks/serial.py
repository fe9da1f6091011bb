"""Serial ports: which there are, who may open them, and how long their drivers hold bytes back."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

from hil.cli.checks.finding import Finding, note, ok, problem

_USB_SERIAL = Path("/sys/bus/usb-serial/devices")
_SHORT_MS = 1


def check() -> Iterator[Finding]:
    """Yield a finding for each port; none is opened, which could reset the board behind it."""
    from serial.tools import list_ports

    ports = [port for port in list_ports.comports() if port.hwid != "n/a"]
    if not ports:
        yield ok("serial ports", "none is plugged in")
    for port in ports:
        told = f"{port.device}: {port.description}"
        if sys.platform != "win32" and not os.access(port.device, os.R_OK | os.W_OK):
            # One that is not USB is on the board of most machines, with nothing behind it.
            say = note if port.vid is None else problem
            yield say("serial port", f"{told}; this user may not open it", _remedy(Path(port.device)))
        else:
            yield _latency(port.device, told)


def _remedy(device: Path) -> str:
    if sys.platform == "win32":
        return ""
    try:
        group = device.group()
    except (KeyError, OSError):
        group = "dialout"
    return f"sudo usermod -aG {group} $USER, and log in again"


def _latency(device: str, told: str) -> Finding:
    """Return how long an FTDI adapter's driver waits for more bytes; others do not tell, or do not wait."""
    timer = _USB_SERIAL / Path(device).name / "latency_timer"
    try:
        held_ms = int(timer.read_text("ascii"))
    except (OSError, ValueError):
        return ok("serial port", told)
    if held_ms <= _SHORT_MS:
        return ok("serial port", f"{told}; low latency, {held_ms} ms")
    # Opening it sets ASYNC_LOW_LATENCY (hil.wire.serial_port), which makes it 1 ms where the driver knows it.
    return note(
        "serial port",
        f"{told}; its driver holds bytes back for {held_ms} ms until a run sets it to low latency",
        f"should feedback be old in a run all the same: echo 1 | sudo tee {timer}",
    )
