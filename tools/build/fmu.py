"""Compiles the plant and packs it as FMUs, one for each FMI version.

``python -m tools.build.fmu`` compiles for this machine with any C compiler; ``--all-platforms`` with zig for all that
``plant_fmu.platforms`` names. Both do nothing when the FMUs are up to date. An FMU depends on nothing but its inputs,
so that its SHA-256 is the same on every run of one compiler; with zig, also on every machine.
"""

import argparse
import hashlib
import sys
import tempfile
from pathlib import Path

import plant_fmu
from firmware_protocol.built import FLAGS, BuildError
from hil.plant.built import FMUS
from plant_fmu import generate, platforms
from plant_fmu.sources import DEFINITION, DESCRIPTIONS, GENERATED, HERE, SOURCES, comment_of
from tools.build import pack
from tools.build.compiler import compile_shared, compiler, version, zig

_INCLUDE = (HERE, GENERATED)


def build(out: Path | None = None, *, fmi: int = 2, cc: str | None = None, all_platforms: bool = False) -> Path:
    """Build the FMU of one FMI version (2 or 3) unless it is up to date, and return its path.

    Raises BuildError when there is no compiler, when it fails, when a generated file is stale, and when
    ``out`` cannot be written.
    """
    return _build({fmi: plant_fmu.path(fmi) if out is None else out}, cc, all_platforms)[0]


def build_all(folder: Path | None = None, *, cc: str | None = None, all_platforms: bool = False) -> list[Path]:
    """Build the FMUs of all FMI versions, by default in the package's folder, and return their paths.

    Raises BuildError as ``build`` does.
    """
    paths = {fmi: plant_fmu.path(fmi) for fmi in DESCRIPTIONS}
    outs = {fmi: path if folder is None else folder / path.name for fmi, path in paths.items()}
    return _build(outs, cc, all_platforms)


def _build(outs: dict[int, Path], cc: str | None, all_platforms: bool) -> list[Path]:
    command = zig() if all_platforms else compiler(cc)
    inputs = {
        fmi: f"{_inputs_digest(fmi, command, all_platforms)} {FMUS[plant_fmu.path(fmi)].digest()}" for fmi in outs
    }
    wanted = {fmi: out for fmi, out in outs.items() if comment_of(out) != inputs[fmi]}
    if wanted and (stale := [path for path in generate.stale() if GENERATED in path.parents]):
        raise BuildError(f"{stale[0].name} is stale; run python -m plant_fmu.generate")
    libraries = _libraries(cc, all_platforms) if wanted else {}
    for fmi, out in wanted.items():
        members = {**platforms.members(fmi, pack.model_identifier(fmi), libraries), **pack.text_members(fmi)}
        try:
            pack.write(members, out, inputs[fmi])
        except OSError as error:
            raise BuildError(f"{out}: cannot be written ({error.strerror}); choose another file") from error
    return list(outs.values())


def _libraries(cc: str | None, all_platforms: bool) -> dict[str, bytes]:
    """Return the library of each platform, by its tuple. One library serves every FMI version."""
    targets = platforms.ZIG_TARGETS if all_platforms else {platforms.this_platform(): None}
    libraries = {}
    with tempfile.TemporaryDirectory(prefix="plant_fmu_") as folder:
        for name, target in targets.items():
            library = Path(folder) / f"mecanum{platforms.suffix(name)}"
            compile_shared(SOURCES, library, include=_INCLUDE, cc=cc, zig_target=target)
            libraries[name] = library.read_bytes()
    return libraries


def _inputs_digest(fmi: int, command: list[str], all_platforms: bool) -> str:
    """Return a hash of all that the FMU is made from: the compiler wherever it is, flags, targets, files."""
    targets = sorted(platforms.ZIG_TARGETS.items()) if all_platforms else platforms.this_platform()
    digest = hashlib.sha256(repr((command[1:], version(command), FLAGS, targets)).encode())
    for module in (sys.modules[__name__], pack, platforms):
        digest.update(Path(str(module.__file__)).read_bytes())
    for name, content in sorted({**pack.text_members(fmi), "variables.toml": DEFINITION.read_bytes()}.items()):
        digest.update(name.encode() + b"\0" + content + b"\0")
    return digest.hexdigest()


def main() -> None:
    """Build the FMUs and print their paths."""
    parser = argparse.ArgumentParser(prog="tools.build.fmu", description="Build the plant's FMUs.")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="where to write them; the package's own by default")
    parser.add_argument("--all-platforms", action="store_true", help="compile with zig for all platforms")
    arguments = parser.parse_args()
    if arguments.all_platforms and arguments.out is None:
        parser.error("--all-platforms makes FMUs to give away; say where to with --out FOLDER")
    try:
        for path in build_all(arguments.out, all_platforms=arguments.all_platforms):
            print(path)
    except BuildError as error:
        sys.exit(f"tools.build.fmu: {error}")


if __name__ == "__main__":
    main()
