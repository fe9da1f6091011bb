"""What is installed; and this machine: kernel, lateness, permissions, serial ports, CAN interfaces, and free space."""

import ctypes.util
import getpass
import importlib.metadata
import os
import platform
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from packaging.requirements import Requirement

from firmware_protocol.built import WHEEL_HOST, is_checkout, run_script
from hil.core.clock import TICK_NS, WallClock
from hil.core.errors import BadInputError
from hil.core.extensions import OUR_PACKAGE
from hil.core.extras import EXTRAS, missing_of
from hil.core.findings import Finding, note, ok, ok_or_note, problem, text_of
from hil.plant import archive
from hil.plant.built import COSIM, FMUS, MUJOCO
from hil.runtime import realtime
from hil.runtime.lateness import Lateness
from hil.scenario.tables import PRIORITY, RealtimeTable

_NATIVE = (WHEEL_HOST, COSIM, *(built for path, built in FMUS.items() if path != MUJOCO))

_RECORDED_BYTES_S = 700_000  # of a recording at 1 kHz, as measured by telemetry_cost, rounded up
_FEW_PROCESSORS = 2
_SLEEPS = 200
_LATE_US = 500.0
_LIMITS = "/etc/security/limits.d/90-mecanum-hil.conf"


def check_versions() -> Iterator[Finding]:
    """Yield the version of Python, and the packages that are missing or have an unsuitable version."""
    try:
        about = importlib.metadata.metadata(OUR_PACKAGE)
    except importlib.metadata.PackageNotFoundError:
        sentence = f"{OUR_PACKAGE} is not installed, so its requirements are not known"
        yield problem("versions", sentence, "pip install -e .")
        return
    python = platform.python_version()
    needed = about["Requires-Python"]
    if not needed or Requirement(f"python{needed}").specifier.contains(python, prereleases=True):
        yield ok("Python", python)
    else:
        remedy = "install a newer Python, and this package into it"
        yield problem("Python", f"{python}, where {needed} is needed", remedy)
    requirements = [Requirement(text) for text in importlib.metadata.requires(OUR_PACKAGE) or ()]
    packages = [one for one in requirements if one.marker is None or one.marker.evaluate({"extra": ""})]
    unmet = [finding for one in packages if (finding := _unmet(one)) is not None]
    if not unmet:
        yield ok("packages", f"all {len(packages)} are installed, in suitable versions")
    yield from unmet
    missing = [extra for extra in EXTRAS if missing_of(extra)]
    there = ", ".join(extra for extra in EXTRAS if extra not in missing) or "none"
    yield ok("extras", there + (f"; not installed: {', '.join(missing)}" if missing else ""))


def _unmet(requirement: Requirement) -> Finding | None:
    name, needed = requirement.name, str(requirement.specifier) or "any version"
    remedy = f"pip install '{name}{requirement.specifier}'"
    try:
        installed = importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return problem("package", f"{name} is not installed, {needed} is needed", remedy)
    if requirement.specifier.contains(installed, prereleases=True):
        return None
    return problem("package", f"{name} is {installed}, {needed} is needed", remedy)


def check_native() -> Iterator[Finding]:
    """Yield the native libraries, the plant FMUs and, in a checkout, the compiler, which only building needs."""
    for built in _NATIVE:
        path = built.path
        subject = "plant" if path.suffix == ".fmu" else "native library"
        remedy = f"python -m {built.module}" if is_checkout(built.root) else "install the package again"
        if not path.is_file():
            yield problem(subject, f"{path.name} is not built", remedy)
        elif not built.is_current():
            yield problem(subject, f"{path.name} was not built from the present sources", remedy)
        elif subject == "plant":
            try:
                yield ok("plant", f"{path.name}, for {', '.join(archive.platforms(path))}")
            except BadInputError as error:
                yield problem("plant", str(error), "hil fmu build")
        else:
            yield ok(subject, path.name)
    if not is_checkout():
        return
    done = run_script("tools.build.compiler")
    remedy = "sudo apt install gcc, or pip install ziglang; only builds need it"
    yield ok_or_note("C compiler", done.returncode == 0, done.stdout.strip(), done.stderr.strip(), remedy)


def check_disk(folder: Path) -> Iterator[Finding]:
    """Yield the free space of the disk under ``folder``, as far as a recording can be written there."""
    place = next(one for one in (folder.absolute(), *folder.absolute().parents) if one.is_dir())
    try:
        with tempfile.TemporaryFile(dir=place) as file:
            file.write(b"a row")
    except OSError as error:
        sentence = f"{place}: a recording cannot be written ({error.strerror})"
        yield problem("disk", sentence, "go to another folder, or free space")
        return
    free_bytes = shutil.disk_usage(place).free
    hours = free_bytes / _RECORDED_BYTES_S / 3600
    space = f"{place}: {free_bytes / 1e9:.1f} GB free, about {hours:.0f} h of recording at 1 kHz"
    yield ok_or_note("disk", hours >= 1.0, space, space, "free some, or record elsewhere with --record FILE")


def check_kernel(root: Path = Path("/")) -> Iterator[Finding]:
    """Yield the findings on a Linux kernel; ``root`` is the folder that holds sys."""
    if sys.platform == "linux":
        yield _preemption(root)
        yield from _governor(root)
        yield from _isolation(root)


def _preemption(root: Path) -> Finding:
    version = platform.release()
    return ok_or_note(
        "kernel",
        text_of(root / "sys/kernel/realtime") == "1" or "PREEMPT_RT" in platform.version(),
        f"Linux {version} with PREEMPT_RT",
        f"Linux {version} without PREEMPT_RT: one of its longer sections can make a tick late",
        "for less lateness install a real-time kernel: sudo apt install linux-image-rt-amd64 (Debian), sudo pro enable "
        "realtime-kernel (Ubuntu)",
    )


def _governor(root: Path) -> Iterator[Finding]:
    """Yield how the processors' frequency is controlled. Virtual machines often have no control of it."""
    folder = root / "sys/devices/system/cpu"
    governors = sorted(set(filter(None, map(text_of, folder.glob("cpu[0-9]*/cpufreq/scaling_governor")))))
    if governors:
        sentence = f"governor {', '.join(governors)}: a processor that slowed down begins a tick slowly"
        remedy = "sudo cpupower frequency-set -g performance"
        yield ok_or_note("frequency", governors == ["performance"], "governor performance", sentence, remedy)


def _isolation(root: Path) -> Iterator[Finding]:
    isolated = realtime.parse_cpus(text_of(root / "sys/devices/system/cpu/isolated") or "")
    if isolated:
        yield ok("processors", f"isolated: {', '.join(map(str, isolated))}; runs in real time use these")
    elif (count := os.cpu_count() or 1) > _FEW_PROCESSORS:
        last = count - 1
        yield note(
            "processors",
            f"none of {count} is isolated: other programs share the controller's",
            f"to keep one free, boot with isolcpus={last} nohz_full={last} on the kernel's command line",
        )


def check_permissions() -> Iterator[Finding]:
    """Yield whether this user may set real-time priority, lock memory, and forbid deep idle states."""
    if sys.platform != "linux":
        return
    limit = 99 if realtime.has_capability(realtime.CAP_SYS_NICE) else realtime.priority_limit()
    fact = f"real-time priority up to {limit}"
    sentence = f"{fact}, where a run asks for {PRIORITY}: other programs make ticks late"
    yield ok_or_note("rtprio", limit >= PRIORITY, fact, sentence, _raise_limit("rtprio", PRIORITY))
    memory_bytes = realtime.memory_limit_bytes()
    if memory_bytes is None or realtime.has_capability(realtime.CAP_IPC_LOCK):
        yield ok("memlock", "all memory may be locked")
    else:
        sentence = f"only {memory_bytes >> 10} KiB may be locked: a page swapped out makes a tick late"
        yield note("memlock", sentence, _raise_limit("memlock", "unlimited"))
    if realtime.DMA_LATENCY.exists():
        yield ok_or_note(
            "idle states",
            os.access(realtime.DMA_LATENCY, os.W_OK),
            "a run can forbid deep ones",
            f"{realtime.DMA_LATENCY} may not be written: a processor may sleep so deep that it wakes late",
            'echo \'KERNEL=="cpu_dma_latency", GROUP="plugdev", MODE="0660"\' | sudo tee '
            "/etc/udev/rules.d/90-mecanum-hil.rules, then sudo udevadm control --reload && sudo udevadm trigger",
        )


def _raise_limit(item: str, value: object) -> str:
    return f"echo '{getpass.getuser()} - {item} {value}' | sudo tee -a {_LIMITS}, and log in again"


def check_lateness() -> Iterator[Finding]:
    """Yield the measured lateness of sleeps of 1 ms."""
    with realtime.real_time(RealtimeTable(lock_memory=False)) as granted:
        late_us = _lateness().percentiles_us()
    has_priority = "priority" in granted.figures()["granted"]
    sentence = (
        f"{_SLEEPS} sleeps of 1 ms, {'with' if has_priority else 'without'} real-time priority: late by "
        f"{late_us['p50']:.0f} µs p50, {late_us['p99']:.0f} µs p99"
    )
    remedy = "end other programs, or isolate a processor" if has_priority else "see rtprio"
    remedy += "; until then choose loop.rate_hz below 1000 (hil/runtime/LIMITS.md)"
    yield ok_or_note("lateness", late_us["p99"] < _LATE_US, sentence, sentence, remedy)


def _lateness() -> Lateness:
    clock, late = WallClock(), Lateness()
    due_ns = clock.now_ns() + TICK_NS
    for _ in range(_SLEEPS):
        late.add(clock.wait_until(due_ns))
        due_ns = max(due_ns, clock.now_ns()) + TICK_NS
    return late


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
    if int(text_of(folder / "flags") or "0", 16) & _IFF_UP:
        return ok("CAN interface", f"{name} is up; its link is can:socketcan/{name}")
    return note("CAN interface", f"{name} is down", f"sudo ip link set {name} up type can bitrate 1000000")
