"""Inside the guest or the network namespace of ``tools.socketcan``: makes the CAN interfaces and runs the command.

This is the first process there, so it takes note of every orphan's end. In the guest it is the init of a kernel
whose root is the host's file system, read-only. It imports nothing of ours: it runs before the command's environment
is there.
"""

import ctypes
import json
import os
import subprocess
import sys
import tty
from pathlib import Path

CAN_MODULES = (
    "net/can/can",
    "net/can/can-raw",
    "drivers/net/can/dev/can-dev",
    "drivers/net/can/vcan",
    "drivers/net/can/vxcan",
    "net/sched/sch_netem",
)
CONSOLE = "/dev/ttyS0"
EXIT_CODE = "exit_code"
JOB = "job.json"
_MOUNTS = (
    ("proc", "/proc", ""),
    ("sysfs", "/sys", ""),
    ("devpts", "/dev/pts", "ptmxmode=666"),
    ("tmpfs", "/dev/shm", ""),
    ("tmpfs", "/run", ""),
)
_SHARE = Path("/run/share")
_POWER_OFF = 0x4321FEDC  # LINUX_REBOOT_CMD_POWER_OFF, reboot(2)
_CLASSIC_MTU, _FD_MTU = 16, 72  # sizeof(struct can_frame), sizeof(struct canfd_frame)


def main() -> None:
    """Run the job of the folder given as the argument; ``--boot`` says that this is the guest's init."""
    folder = Path(sys.argv[1])
    if "--boot" not in sys.argv:
        (folder / EXIT_CODE).write_text(str(_run(folder)))
        return
    try:
        share = _boot(folder)
        (share / EXIT_CODE).write_text(str(_run(folder)))
    except (OSError, subprocess.CalledProcessError) as error:
        print(f"the guest could not be set up: {error}", flush=True)
    finally:
        os.sync()
        os.close(1)  # waits until the console has written everything
        ctypes.CDLL(None).reboot(_POWER_OFF)


def _boot(folder: Path) -> Path:
    """Mount the file systems that a Linux process expects, and return the writable path of the folder."""
    os.environ["PATH"] = "/usr/local/bin:/usr/bin:/bin:/usr/sbin:/sbin"
    console = os.open(CONSOLE, os.O_WRONLY | os.O_NOCTTY)
    tty.setraw(console)
    for descriptor in (1, 2):
        os.dup2(console, descriptor)
    os.close(console)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    for kind, where, options in _MOUNTS:
        if where.startswith("/dev/"):  # the kernel has mounted /dev, in its memory
            Path(where).mkdir(exist_ok=True)
        _mount(kind, where, options)
    for name in ("share", "tmp", "home"):
        Path("/run", name).mkdir()
    _mount("hostfs", str(_SHARE), str(folder))
    modules = Path("/usr/lib/uml/modules", os.uname().release, "kernel")
    for module in CAN_MODULES:
        _command("insmod", str(modules / f"{module}.ko"))
    return _SHARE


def _run(folder: Path) -> int:
    """Make the interfaces, run the command, and return its exit code."""
    job = json.loads((folder / JOB).read_text())
    os.environ.clear()
    os.environ.update(job["environment"])
    _command("ip", "link", "set", "lo", "up")
    for name, mtu in (("vcan0", _CLASSIC_MTU), ("vcan1", _FD_MTU)):
        _command("ip", "link", "add", name, "type", "vcan")
        _command("ip", "link", "set", name, "mtu", str(mtu), "up")
    os.chdir(job["directory"])
    try:
        process = subprocess.Popen(job["command"])
    except OSError as error:
        print(f"{job['command'][0]} cannot be started: {error}", flush=True)
        return 127
    while True:
        pid, status = os.wait()
        if pid == process.pid:
            code = os.waitstatus_to_exitcode(status)
            return code if code >= 0 else 128 - code


def _mount(kind: str, where: str, options: str) -> None:
    _command("mount", "-t", kind, *(("-o", options) if options else ()), kind, where)


def _command(*arguments: str) -> None:
    subprocess.run(arguments, check=True)


if __name__ == "__main__":
    main()
