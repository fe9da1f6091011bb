"""CAN: the kernel's interfaces, their bit rates, and the drivers of makers."""

import ctypes.util
import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hil.cli.checks.finding import Finding, note, ok, text_of

NET = Path("/sys/class/net")
_ARPHRD_CAN = "280"
_IFF_UP = 1
# As python-can finds them: the library's name for ctypes by the interface's.
_MAKERS = {
    "pcan": "PCANBasic" if sys.platform == "win32" else "pcanbasic",
    "kvaser": "canlib32" if sys.platform == "win32" else "canlib",
}


def check(net: Path = NET) -> Iterator[Finding]:
    """Yield a finding for each interface, and the makers' libraries; ``net`` is where the kernel's devices are."""
    found = False
    if sys.platform == "linux":
        for folder in sorted(net.glob("*")):
            if text_of(folder / "type") == _ARPHRD_CAN:
                found = True
                yield _interface(folder)
    libraries = [maker for maker, name in _MAKERS.items() if ctypes.util.find_library(name)]
    if libraries:
        yield ok("CAN drivers", f"of makers, for python-can: {', '.join(libraries)}")
    elif not found:
        yield ok("CAN", "no interface and no maker's driver; a serial line needs none")


def _interface(folder: Path) -> Finding:
    name = folder.name
    told = _told_by_ip(name)
    timing = told.get("linkinfo", {}).get("info_data", {}).get("bittiming", {})
    is_virtual = told.get("linkinfo", {}).get("info_kind") in ("vcan", "vxcan")
    rate = f" at {timing['bitrate']} bit/s" if timing.get("bitrate") else ""
    if int(text_of(folder / "flags") or "0", 16) & _IFF_UP:
        return ok("CAN interface", f"{name} is up{rate}; its link is can:socketcan/{name}")
    how = "" if is_virtual else " type can bitrate 1000000"
    return note("CAN interface", f"{name} is down", f"sudo ip link set {name} up{how}")


def _told_by_ip(name: str) -> dict[str, Any]:
    """Return what iproute2 says of an interface; empty without it."""
    ip = shutil.which("ip")
    if ip is None:
        return {}
    done = subprocess.run(
        [ip, "-details", "-json", "link", "show", name], capture_output=True, text=True, check=False, timeout=5
    )
    rows = json.loads(done.stdout or "[]") if done.returncode == 0 else []
    return rows[0] if rows else {}
