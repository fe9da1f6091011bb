"""``python -m tools.release`` makes what a release gives away, into ``dist/``: see ``make release``.

That is a wheel for each platform, each for all Pythons; a source distribution; the FMUs; a list of their dependencies
(``sbom.cdx.json``, CycloneDX 1.6); the changes (``CHANGES.md``); and the checksums of all of it (``SHA256SUMS``). Each
wheel is checked: the format of its libraries, the machine they are for, and what they export.
"""

import argparse
import email
import hashlib
import json
import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import lief
from packaging.requirements import Requirement

from hil import __version__
from tools.build.native import WHEEL_TAGS

ROOT = Path(__file__).parents[1]
_FORMATS = {"linux": lief.ELF.Binary, "windows": lief.PE.Binary, "darwin": lief.MachO.Binary}
EXPORTS = {
    "_wheel": ("wheel_host_init", "wheel_client_poll", "PyInit__wheel", "built_from_sources"),
    "libcosim": ("cosim_start", "cosim_exchange", "built_from_sources"),
}


def build(out: Path, platforms: tuple[str, ...] = tuple(WHEEL_TAGS)) -> list[Path]:
    """Build and check the wheels, the source distribution, and what goes with them; return their paths."""
    out.mkdir(parents=True, exist_ok=True)
    wheels = [_hatchling(out, "wheel", platform) for platform in platforms]
    for wheel, platform in zip(wheels, platforms, strict=True):
        if problems := list(faults(wheel, platform)):
            raise SystemExit(f"{wheel.name}: {'; '.join(problems)}")
    made = [*wheels, _hatchling(out, "sdist")]
    fmus = sorted((ROOT / "build" / "wheels").glob("*.fmu"))
    made += [Path(shutil.copy2(fmu, out)) for fmu in fmus]
    (bill := out / "sbom.cdx.json").write_text(json.dumps(sbom(wheels[0]), indent=1) + "\n", encoding="utf-8")
    (changes := out / "CHANGES.md").write_text(newest_changes(), encoding="utf-8")
    made += [bill, changes]
    sums = "".join(f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in made)
    (out / "SHA256SUMS").write_text(sums, encoding="ascii")
    return [*made, out / "SHA256SUMS"]


def faults(wheel: Path, platform: str) -> Iterator[str]:
    """Yield the errors of a wheel: its name, its libraries, or libraries of another platform."""
    if not wheel.name.endswith(f"-cp311-abi3-{WHEEL_TAGS[platform]}.whl"):
        yield f"its name does not end in cp311-abi3-{WHEEL_TAGS[platform]}"
    machine, system = platform.split("-")
    with zipfile.ZipFile(wheel) as archive:
        libraries = {
            name: archive.read(name) for name in archive.namelist() if name.endswith((".so", ".pyd", ".dll", ".dylib"))
        }
    if {_stem(name) for name in libraries} != EXPORTS.keys() or len(libraries) != len(EXPORTS):
        yield f"it has the libraries {', '.join(sorted(libraries))}"
    for name, content in libraries.items():
        parsed: Any = lief.parse(content)
        if type(parsed) is not _FORMATS[system]:
            yield f"{name} is not of the format of {system}"
            continue
        found = {"ARM64": "aarch64", "X86_64": "x86_64"}[parsed.abstract.header.architecture.name]
        if found != machine:
            yield f"{name} is for {found}"
        entries = parsed.abstract.exported_functions if system == "windows" else parsed.symbols
        exported = {str(one.name).removeprefix("_") for one in entries}
        yield from (f"{name} does not export {one}" for one in EXPORTS.get(_stem(name), ()) if one not in exported)


def _stem(name: str) -> str:
    return Path(name).name.partition(".")[0]


def sbom(wheel: Path) -> dict[str, Any]:
    """Return the bill of materials of a wheel: the packages that it declares to need, extras marked as optional."""
    with zipfile.ZipFile(wheel) as archive:
        [name] = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
        about = email.message_from_bytes(archive.read(name))
    parts = []
    for text in about.get_all("Requires-Dist", ()):
        needed = Requirement(text)
        if needed.name == about["Name"]:  # an extra that is made of others
            continue
        is_extra = "extra" in str(needed.marker or "")
        parts.append({
            "type": "library",
            "name": needed.name,
            "purl": f"pkg:pypi/{needed.name.lower()}",
            "scope": "optional" if is_extra else "required",
            "properties": [{"name": "requirement", "value": text}],
        })  # fmt: skip
    ours = {
        "type": "application",
        "name": about["Name"],
        "version": about["Version"],
        "licenses": [{"license": {"id": about["License-Expression"]}}],
    }
    return {"bomFormat": "CycloneDX", "specVersion": "1.6", "version": 1, "metadata": {"component": ours},
            "components": parts}  # fmt: skip


def newest_changes() -> str:
    """Return the newest section of the changelog under the name of this version."""
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    section = text.split("\n## ")[1].partition("\n")[2]
    return f"# {__version__}\n{section.rstrip()}\n"


def _hatchling(out: Path, kind: str, platform: str | None = None) -> Path:
    environment = {**os.environ, **({} if platform is None else {"HIL_WHEEL_PLATFORM": platform})}
    command = [sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", str(out)]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SystemExit(done.stdout + done.stderr)
    pattern = "*.tar.gz" if platform is None else f"*-{WHEEL_TAGS[platform]}.whl"
    [made] = out.glob(f"mecanum_hil-{__version__}{pattern}")
    return made


def main() -> None:
    """Make the release and print its files."""
    parser = argparse.ArgumentParser(prog="tools.release", description="Make what a release gives away.")
    parser.add_argument("--out", type=Path, default=ROOT / "dist", metavar="DIR", help="where to; by default dist/")
    parser.add_argument("--platform", choices=WHEEL_TAGS, action="append", help="a wheel for this one only; repeatable")
    arguments = parser.parse_args()
    for path in build(arguments.out, tuple(arguments.platform or WHEEL_TAGS)):
        print(path)


if __name__ == "__main__":
    main()
