"""The native files of a wheel, for this machine or, with zig, for another one."""

from pathlib import Path

import plant_fmu
from firmware_protocol import declarations
from firmware_protocol.built import SOURCES as FIRMWARE
from firmware_protocol.built import WHEEL_HOST, Built
from hil.plant import built as plant
from plant_fmu import platforms
from plant_fmu.sources import DESCRIPTIONS
from tools.build import cosim, fmu, wheel_host
from tools.build.compiler import compile_shared

WHEEL_TAGS = {
    "x86_64-linux": "manylinux_2_17_x86_64",
    "aarch64-linux": "manylinux_2_17_aarch64",
    "x86_64-windows": "win_amd64",
    "x86_64-darwin": "macosx_11_0_x86_64",
    "aarch64-darwin": "macosx_11_0_arm64",
}
"""The platforms of a release, and what a wheel's name calls each: the C libraries are those of ``ZIG_TARGETS``."""


def build_here() -> dict[Path, str]:
    """Build for this machine, beside the sources; return each file and its place in the wheel."""
    libraries = [wheel_host.build(), cosim.build()]
    files = [*libraries, *(library.with_suffix(".cffi") for library in libraries), *fmu.build_all()]
    return {file: file.relative_to(WHEEL_HOST.root).as_posix() for file in files}


def build_for(platform: str, folder: Path) -> dict[Path, str]:
    """Build for another machine into a folder; return each file and its place in the wheel.

    The FMUs have binaries for all platforms. They lie beside the folder, and are the same bytes in every wheel. Raises
    BuildError without zig.
    """
    files = libraries_for(platform, folder)
    fmus = zip(fmu.build_all(folder.parent, all_platforms=True), DESCRIPTIONS, strict=True)
    return files | {made: f"plant_fmu/{plant_fmu.path(fmi).name}" for made, fmi in fmus}


def libraries_for(platform: str, folder: Path) -> dict[Path, str]:
    """Build the libraries alone, with their declarations. Raises BuildError without zig."""
    folder.mkdir(parents=True, exist_ok=True)
    firmware = _library(WHEEL_HOST, platform, folder, FIRMWARE, ())
    declarations.write_declarations(firmware, declarations.HEADERS, declarations.TABLE)
    shim = _library(plant.COSIM, platform, folder, plant.SOURCES, plant.INCLUDE)
    declarations.write_declarations(shim, plant.HEADERS)
    files: dict[Path, str] = {}
    for library, built in ((firmware, WHEEL_HOST), (shim, plant.COSIM)):
        place = built.path.parent.relative_to(built.root).as_posix()
        files |= {made: f"{place}/{made.name}" for made in (library, library.with_suffix(".cffi"))}
    return files


def _library(built: Built, platform: str, folder: Path, sources: tuple[Path, ...], include: tuple[Path, ...]) -> Path:
    suffix = platforms.suffix(platform)
    if built.of_python is not None:
        suffix = ".pyd" if suffix == ".dll" else ".abi3.so"
    made = folder / f"{built.path.name.partition('.')[0]}{suffix}"
    compile_shared(sources, made, include=include, zig_target=platforms.ZIG_TARGETS[platform], built=built)
    return made
