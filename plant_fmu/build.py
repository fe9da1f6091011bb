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
from plant_fmu import generate

HERE = Path(__file__).parent
DESCRIPTION = HERE / "generated" / "modelDescription.xml"
SOURCES = tuple(HERE / name for name in generate.SOURCE_FILES)
HEADERS = (
    HERE / "fmi2.h",
    HERE / "instance.h",
    HERE / "mecanum.h",
    HERE / "physics.h",
    HERE / "generated" / "mecanum_variables.h",
)
DOCUMENTS = (HERE / "documentation" / "index.html", HERE / "documentation" / "licenses" / "license.txt")
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
_DATE = (1980, 1, 1, 0, 0, 0)


class BuildError(Exception):
    """The FMU could not be built; the message says what to do."""


def binaries_folder() -> str:
    """Return the folder of this platform's binary in an FMI 2.0 archive (section 2.3): ``linux64``.

    The standard's names do not tell one 64-bit architecture from another.
    """
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


def build(out: Path | None = None, cc: str | None = None) -> Path:
    """Build the FMU unless it is up to date, and return its path.

    Raises BuildError when there is no compiler, when it fails, when a generated file is stale, and when
    ``out`` cannot be written.
    """
    out = plant_fmu.path() if out is None else out
    inputs = _inputs_digest(compiler(cc))
    if _is_made_from(out, inputs):
        return out
    if stale := [path for path in generate.stale() if path.parent == DESCRIPTION.parent]:
        raise BuildError(f"{stale[0].name} is stale; run python -m plant_fmu.generate")
    with tempfile.TemporaryDirectory(prefix="plant_fmu_") as folder:
        library = Path(folder) / f"mecanum{SUFFIX}"
        compile_shared(SOURCES, library, include=(HERE, HERE / "generated"), cc=cc, flags=("-fvisibility=hidden",))
        members = {f"binaries/{binaries_folder()}/{library.name}": library.read_bytes(), **_text_members()}
    try:
        _pack(members, out, inputs)
    except OSError as error:
        raise BuildError(f"{out}: cannot be written ({error.strerror}); choose another file") from error
    return out


def _text_members() -> dict[str, bytes]:
    files = {
        "modelDescription.xml": DESCRIPTION,
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


def _inputs_digest(command: list[str]) -> str:
    """Return a hash of all that the FMU is made from, the compiler included."""
    version = subprocess.run([*command, "--version"], capture_output=True, text=True, check=False).stdout
    digest = hashlib.sha256(repr((command, version, FLAGS, platform.machine(), binaries_folder())).encode())
    for path in (Path(__file__), HERE / "variables.toml", DESCRIPTION, *SOURCES, *HEADERS, *DOCUMENTS):
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
    """Build the FMU and print its path."""
    parser = argparse.ArgumentParser(prog="plant_fmu.build", description="Build the plant's FMU for this machine.")
    parser.add_argument("--out", type=Path, help="the FMU to write; the package's own by default")
    try:
        print(build(parser.parse_args().out))
    except BuildError as error:
        sys.exit(f"plant_fmu.build: {error}")


if __name__ == "__main__":
    main()
