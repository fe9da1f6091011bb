"""Compiles the plant for this machine and packs it as an FMU. Needs the standard library and a C compiler.

``python -m plant_fmu.build [--out FILE]`` does nothing when the FMU is up to date. The archive depends on
nothing but its inputs (fixed dates, no compression), so that the FMU's SHA-256 is the same on every run of
one compiler.
"""

import argparse
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Iterable, Sequence
from pathlib import Path

import plant_fmu
from plant_fmu import generate, manifest

HERE = Path(__file__).parent
SOURCES = tuple(HERE / name for name in generate.SOURCE_FILES)
HEADERS = (*sorted(HERE.glob("*.h")), generate.GENERATED / "mecanum_variables.h")
DOCUMENTS = (HERE / "documentation" / "index.html", HERE / "documentation" / "licenses" / "license.txt")
# Reference results, the same in both versions' archives: member -> file.
REFERENCE = {f"{manifest.FOLDER}/{path.name}": path for path in (generate.GENERATED / manifest.NAME, *manifest.files())}
# What each version's archive holds beside the binary, the sources and the documents: member -> file.
DESCRIPTIONS = {
    2: {"modelDescription.xml": generate.GENERATED / "fmi2" / "modelDescription.xml"},
    3: {
        "modelDescription.xml": generate.GENERATED / "fmi3" / "modelDescription.xml",
        "terminalsAndIcons/terminalsAndIcons.xml": generate.GENERATED / "fmi3" / "terminalsAndIcons.xml",
    },
}
# Without fused multiply-add the same sources give the same numbers on every machine that rounds by IEEE 754.
FLAGS = (
    "-std=c11",
    "-O2",
    "-ffp-contract=off",
    "-Wall",
    "-Wextra",
    "-Wconversion",
    "-Werror",
)
SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
_MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}  # names of Windows and macOS
_DATE = (1980, 1, 1, 0, 0, 0)


class BuildError(Exception):
    """The FMU could not be built; the message says what to do."""


def binaries_folder(fmi: int) -> str:
    """Return the folder of this platform's binary: ``linux64`` in FMI 2.0, ``x86_64-linux`` in 3.0.

    FMI 2.0 section 2.3, whose names do not tell one 64-bit architecture from another; FMI 3.0 section 2.5.
    """
    if fmi == 3:
        machine = platform.machine().lower()
        system = {"win32": "windows", "darwin": "darwin"}.get(sys.platform, "linux")
        return "-".join((_MACHINES.get(machine, machine), system))
    system = {"win32": "win", "darwin": "darwin"}.get(sys.platform, "linux")
    return f"{system}{64 if sys.maxsize > 2**32 else 32}"


def compiler(cc: str | None = None) -> list[str]:
    """Return the C compiler's command: ``cc``, ``$CC``, or cc, gcc, clang. Raises BuildError without one.

    A command may have several words, such as ``python -m ziglang cc``.
    """
    given = cc or os.environ.get("CC")
    commands = [shlex.split(given)] if given else [["cc"], ["gcc"], ["clang"]]
    for command in commands:
        if found := shutil.which(command[0]):
            return [found, *command[1:]]
    tried = ", ".join(command[0] for command in commands)
    raise BuildError(f"no C compiler found (tried {tried}); install one, for example gcc, or set CC")


def compile_shared(
    sources: Iterable[Path],
    library: Path,
    include: Sequence[Path] = (),
    cc: str | None = None,
    flags: Sequence[str] = (),
) -> None:
    """Compile C sources into a shared library, whole or not at all. Raises BuildError with what cc said."""
    unfinished = library.with_name(f"{library.name}.{os.getpid()}.tmp")
    windows = sys.platform == "win32"
    command = [*compiler(cc), *FLAGS, *flags, "-shared", *([] if windows else ["-fPIC"])]
    command += [f"-I{folder}" for folder in include]
    command += [*map(str, sources), "-o", str(unfinished), *([] if windows else ["-lm"])]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        unfinished.unlink(missing_ok=True)
        raise BuildError(f"{shlex.join(command)} failed:\n{done.stderr}")
    unfinished.replace(library)


def build(out: Path | None = None, cc: str | None = None, fmi: int = 2) -> Path:
    """Build the FMU of FMI version 2 or 3 unless it is up to date, and return its path.

    Raises BuildError when there is no compiler, when it fails, when a generated file is stale, and when
    ``out`` cannot be written.
    """
    out = plant_fmu.path(fmi) if out is None else out
    inputs = _inputs_digest(compiler(cc), fmi)
    if _is_made_from(out, inputs):
        return out
    if stale := [path for path in generate.stale() if generate.GENERATED in path.parents]:
        raise BuildError(f"{stale[0].name} is stale; run python -m plant_fmu.generate")
    with tempfile.TemporaryDirectory(prefix="plant_fmu_") as folder:
        library = Path(folder) / f"mecanum{SUFFIX}"
        compile_shared(SOURCES, library, include=(HERE, HERE / "generated"), cc=cc, flags=("-fvisibility=hidden",))
        members = {f"binaries/{binaries_folder(fmi)}/{library.name}": library.read_bytes(), **_text_members(fmi)}
    try:
        _pack(members, out, inputs)
    except OSError as error:
        raise BuildError(f"{out}: cannot be written ({error.strerror}); choose another file") from error
    return out


def _text_members(fmi: int) -> dict[str, bytes]:
    files = {
        **DESCRIPTIONS[fmi],
        **REFERENCE,
        **{f"sources/{path.name}": path for path in (*SOURCES, *HEADERS)},
        **{path.relative_to(HERE).as_posix(): path for path in DOCUMENTS},
    }
    members = {name: path.read_bytes() for name, path in files.items()}
    return {**members, "sources/buildDescription.xml": _build_description()}


def _build_description() -> bytes:
    """Return how to compile ``sources/``: FMI 3.0 section 2.5.5, which importers of 2.0 read too."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier="mecanum")
    files = ET.SubElement(configuration, "SourceFileSet", language="C11")
    for source in SOURCES:
        ET.SubElement(files, "SourceFile", name=source.name)
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()


def _inputs_digest(command: list[str], fmi: int) -> str:
    """Return a hash of all that the FMU is made from, the compiler included."""
    version = subprocess.run([*command, "--version"], capture_output=True, text=True, check=False).stdout
    digest = hashlib.sha256(repr((command, version, FLAGS, platform.machine(), binaries_folder(fmi))).encode())
    for path in (
        Path(__file__),
        HERE / "variables.toml",
        *DESCRIPTIONS[fmi].values(),
        *REFERENCE.values(),
        *SOURCES,
        *HEADERS,
        *DOCUMENTS,
    ):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def _is_made_from(out: Path, inputs: str) -> bool:
    if not zipfile.is_zipfile(out):
        return False
    with zipfile.ZipFile(out) as archive:
        return archive.comment == inputs.encode()


def _pack(members: dict[str, bytes], out: Path, inputs: str) -> None:
    out.parent.mkdir(parents=True, exist_ok=True)
    unfinished = out.with_name(f"{out.name}.{os.getpid()}.tmp")
    try:
        with zipfile.ZipFile(unfinished, "w") as archive:
            archive.comment = inputs.encode()
            for name in sorted(members):
                entry = zipfile.ZipInfo(name, date_time=_DATE)
                entry.create_system, entry.external_attr = 3, 0o100644 << 16
                archive.writestr(entry, members[name])
        unfinished.replace(out)
    finally:
        unfinished.unlink(missing_ok=True)


def main() -> None:
    """Build the FMUs and print their paths."""
    parser = argparse.ArgumentParser(prog="plant_fmu.build", description="Build the plant's FMUs for this machine.")
    parser.add_argument("--out", type=Path, help="the FMI 2.0 FMU alone, to this file; both in the package by default")
    out = parser.parse_args().out
    try:
        for fmi in (2,) if out else (2, 3):
            print(build(out, fmi=fmi))
    except BuildError as error:
        sys.exit(f"plant_fmu.build: {error}")


if __name__ == "__main__":
    main()
