"""Runs the wheels of ``make release`` on other machines and Pythons: ``python -m tools.elsewhere``, Linux, by hand.

The demo runs on ARM64 under qemu-user and on a newer Python, each from the files of a Debian; its figures are compared
with those of this machine. The libraries of the Windows wheel are loaded by a program under wine, without the demo: no
Debian has a Python for Windows. It needs mmdebstrap, qemu-user and wine (apt install), a network, and some minutes.
"""

import argparse
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tools.build.compiler import zig
from tools.debian import make_debian
from tools.release import EXPORTS

ROOT = Path(__file__).parents[1]
_DEMO = ("hil", "run", "paper_circle", "--record", "none", "--json")
_OF_A_MACHINE = ("tick_us", "realtime_factor", "latency_us", "lateness_us", "wall_s", "baseline", "realtime")
"""Figures of a run that are of the machine, or name its files."""
_LAST_PLACES = 1e-12
"""Relative: sums of NumPy have another order on another processor."""


class Machine(NamedTuple):
    """A Debian, the name of its architecture for Debian and for Linux, and its Python."""

    suite: str
    debian: str
    linux: str
    python: str


MACHINES = {
    "arm64": Machine("bookworm", "arm64", "aarch64", "3.11"),
    "python3.13": Machine("trixie", "amd64", "x86_64", "3.13"),
}
_LOADER = r"""
#include <stdio.h>
#include <string.h>
#include <windows.h>

int main(int count, char **words) {
    /* An extension module imports python3.dll, which is not there. */
    DWORD flags = strstr(words[1], ".pyd") ? DONT_RESOLVE_DLL_REFERENCES : 0;
    HMODULE library = LoadLibraryExA(words[1], NULL, flags);
    if (!library) {
        printf("%s is not loaded: error %lu\n", words[1], GetLastError());
        return 1;
    }
    for (int i = 2; i < count; i++) {
        if (!GetProcAddress(library, words[i])) {
            printf("%s does not export %s\n", words[1], words[i]);
            return 1;
        }
    }
    return 0;
}
"""


def figures_here() -> dict[str, Any]:
    """Return the figures of the demo on this machine."""
    return _figures([sys.executable, "-m", *_DEMO], {}, ROOT)


def figures_on(machine: Machine, wheels: Path, folder: Path) -> dict[str, Any]:
    """Return the figures of the demo on another machine: the wheel with all it needs, as pip chooses it for there."""
    root, site = folder / "root", folder / "root" / "site"
    make_debian(root, "base-files,python3,libstdc++6", suite=machine.suite, variant="extract", machine=machine.debian)
    tags = [f"manylinux_2_{minor}_{machine.linux}" for minor in range(5, 40)] + [f"manylinux2014_{machine.linux}"]
    chosen = ["--only-binary=:all:", "--python-version", machine.python, "--implementation", "cp"]
    chosen += [word for tag in tags for word in ("--platform", tag)]
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-compile", "--target", str(site)]
    _run([*pip, *chosen, "--find-links", str(wheels), "mecanum-hil"])
    python = f"/usr/bin/python{machine.python}"
    environment = {"PYTHONPATH": "/site", "PYTHONDONTWRITEBYTECODE": "1"}
    if machine.linux == platform.machine():
        return _figures(["unshare", "--map-root-user", "chroot", str(root), python, "-m", *_DEMO], environment, folder)
    # All that its processor can have: NumPy may ask for more than the default.
    emulated = [f"qemu-{machine.linux}", "-cpu", "max", "-L", str(root), f"{root}{python}"]
    return _figures([*emulated, "-m", *_DEMO], environment | {"PYTHONPATH": str(site)}, folder)


def differences(here: Any, there: Any, name: str = "") -> Iterator[str]:
    """Yield the figures that differ, but for the last places of a number."""
    if isinstance(here, dict) and isinstance(there, dict):
        for key in here.keys() | there.keys():
            if key not in _OF_A_MACHINE:
                yield from differences(here.get(key), there.get(key), f"{name}.{key}".lstrip("."))
    elif isinstance(here, list) and isinstance(there, list) and len(here) == len(there):
        for number, (one, other) in enumerate(zip(here, there, strict=True), 1):
            yield from differences(one, other, f"{name}.{number}")
    elif isinstance(here, float) and isinstance(there, float):
        if abs(here - there) > _LAST_PLACES * abs(here):
            yield f"{name} is {there!r}, and here {here!r}"
    elif here != there:
        yield f"{name} is {there!r}, and here {here!r}"


def load_under_wine(wheel: Path, folder: Path) -> None:
    """Load the libraries of the Windows wheel, and look for each function; of the plant's also what it imports."""
    (folder / "loader.c").write_text(_LOADER, encoding="ascii")
    loader = folder / "loader.exe"
    # From there, as when the libraries were compiled: zig then has its C library already.
    _run([*zig(), "-target", "x86_64-windows-gnu", "loader.c", "-o", loader.name], folder=folder)
    with zipfile.ZipFile(wheel) as archive:
        libraries = [name for name in archive.namelist() if name.endswith((".dll", ".pyd"))]
        archive.extractall(folder, libraries)
    quiet = {"WINEPREFIX": str(folder / "prefix"), "WINEDEBUG": "-all", "WINEDLLOVERRIDES": "mscoree,mshtml="}
    for name in libraries:
        _run(["wine", str(loader), str(folder / name), *EXPORTS[Path(name).stem]], {**os.environ, **quiet})


def _figures(command: list[str], environment: Mapping[str, str], folder: Path) -> dict[str, Any]:
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL_ENV"))}
    found: dict[str, Any] = json.loads(_run(command, {**kept, **environment}, folder))
    return found


def _run(command: list[str], environment: Mapping[str, str] | None = None, folder: Path | None = None) -> str:
    try:
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        raise SystemExit(f"{command[0]} is not installed; apt install qemu-user wine") from None
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(command[:4])} ... failed:\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.stdout


def main() -> int:
    """Run on each machine that was asked for, print what differs, and return 1 if something does."""
    parser = argparse.ArgumentParser(prog="tools.elsewhere", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--wheels", type=Path, default=ROOT / "dist", metavar="DIR", help="by default dist/")
    parser.add_argument("--only", choices=[*MACHINES, "windows"], action="append", help="this one; may be repeated")
    options = parser.parse_args()
    asked = options.only or [*MACHINES, "windows"]
    worst = 0
    here = figures_here() if set(asked) & MACHINES.keys() else {}
    for name in asked:
        folder = Path(tempfile.mkdtemp(prefix="hil-elsewhere-"))
        try:
            if name == "windows":
                [wheel] = options.wheels.glob("mecanum_hil-*-win_amd64.whl")
                load_under_wine(wheel, folder)
                print("windows: the libraries load under wine, with every function", flush=True)
                continue
            found = figures_on(MACHINES[name], options.wheels, folder)
            differing = list(differences(here, found))
            print(f"{name}: {'; '.join(differing) or 'the figures of the demo are equal'}", flush=True)
            worst |= bool(differing)
        finally:
            shutil.rmtree(folder)
    return worst


if __name__ == "__main__":
    sys.exit(main())
