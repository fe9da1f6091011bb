"""Serial ports and CAN interfaces: which exist, who may open them, and what slows them down."""

import ctypes.util
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hil.cli.checks import Finding, note, ok, problem, text_of

_USB_SERIAL = Path("/sys/bus/usb-serial/devices")
_SHORT_MS = 1
NET = Path("/sys/class/net")
_ARPHRD_CAN = "280"
_IFF_UP = 1
_WINDOWS = sys.platform == "win32"
# The manufacturers' libraries, by interface of python-can, under the names by which ctypes finds them.
_MAKERS = {"pcan": "PCANBasic" if _WINDOWS else "pcanbasic", "kvaser": "canlib32" if _WINDOWS else "canlib"}


def check_serial() -> Iterator[Finding]:
    """Yield a finding for each serial port; none is opened, which could reset the board behind it."""
    from serial.tools import list_ports

    ports = [port for port in list_ports.comports() if port.hwid != "n/a"]
    if not ports:
        yield ok("serial ports", "none is plugged in")
    for port in ports:
        name = f"{port.device}: {port.description}"
        if not _WINDOWS and not os.access(port.device, os.R_OK | os.W_OK):
            # Most machines have a port on the main board (not USB) with nothing connected.
            finding = note if port.vid is None else problem
            yield finding("serial port", f"{name}; this user may not open it", _remedy(Path(port.device)))
        else:
            yield _latency(port.device, name)


def _remedy(device: Path) -> str:
    if sys.platform == "win32":
        return ""
    try:
        group = device.group()
    except (KeyError, OSError):
        group = "dialout"
    return f"sudo usermod -aG {group} $USER, and log in again"


def _latency(device: str, name: str) -> Finding:
    """Report how long an FTDI adapter's driver waits for more bytes. Other drivers do not wait, or do not report it."""
    timer = _USB_SERIAL / Path(device).name / "latency_timer"
    try:
        latency_ms = int(timer.read_text("ascii"))
    except (OSError, ValueError):
        return ok("serial port", name)
    if latency_ms <= _SHORT_MS:
        return ok("serial port", f"{name}; low latency, {latency_ms} ms")
    # A run sets ASYNC_LOW_LATENCY (hil.wire.serial_port) when it opens the port, which gives 1 ms if the driver
    # supports it.
    return note(
        "serial port",
        f"{name}; its driver holds bytes back for {latency_ms} ms until a run sets it to low latency",
        f"if feedback is old in a run all the same: echo 1 | sudo tee {timer}",
    )


def check_can(net: Path = NET) -> Iterator[Finding]:
    """Yield a finding for each CAN interface in the kernel's folder ``net``, and one for the makers' libraries."""
    folders = sorted(net.glob("*")) if sys.platform == "linux" else []
    interfaces = [folder for folder in folders if text_of(folder / "type") == _ARPHRD_CAN]
    yield from map(_interface, interfaces)
    libraries = [maker for maker, name in _MAKERS.items() if ctypes.util.find_library(name)]
    if libraries:
        yield ok("CAN drivers", f"manufacturers' libraries for python-can: {', '.join(libraries)}")
    elif not interfaces:
        yield ok("CAN", "no interface and no manufacturer's driver; a serial line needs none")


def _interface(folder: Path) -> Finding:
    name = folder.name
    link = _link_info(name)
    bit_rate = link.get("info_data", {}).get("bittiming", {}).get("bitrate")
    if int(text_of(folder / "flags") or "0", 16) & _IFF_UP:
        at = f" at {bit_rate} bit/s" if bit_rate else ""
        return ok("CAN interface", f"{name} is up{at}; its link is can:socketcan/{name}")
    options = "" if link.get("info_kind") in ("vcan", "vxcan") else " type can bitrate 1000000"
    return note("CAN interface", f"{name} is down", f"sudo ip link set {name} up{options}")


def _link_info(name: str) -> dict[str, Any]:
    """Return the ``linkinfo`` of an interface from iproute2; empty if that is not installed."""
    ip = shutil.which("ip")
    if ip is None:
        return {}
    done = subprocess.run(
        [ip, "-details", "-json", "link", "show", name], capture_output=True, text=True, check=False, timeout=5
    )
    rows = json.loads(done.stdout or "[]") if done.returncode == 0 else []
    return rows[0].get("linkinfo", {}) if rows else {}
