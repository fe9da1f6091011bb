"""FMUs that are not the shipped one: its own sources with a flaw, packed under another name."""

import shutil
import zipfile
from pathlib import Path

import fmpy

import tools.build.fmu

FLAWED = Path(__file__).parent / "fmus" / "misbehaving.c"
_WRAPPED = ("fmi2Instantiate", "fmi2Reset", "fmi2DoStep", "fmi2GetReal", "fmi2SetReal")


def build_flawed(folder: Path) -> Path:
    """Build the FMU that misbehaves as ``FLAW`` in the environment says, and is sound without it."""
    shipped = tools.build.fmu.build()
    with zipfile.ZipFile(shipped) as archive:
        archive.extractall(folder / "shipped")
    (binaries,) = (folder / "shipped" / "binaries").glob(f"{fmpy.platform}/*")
    sources = folder / "shipped" / "sources"
    tools.build.fmu.compile_shared(
        [FLAWED, *sorted(sources.glob("*.c"))],
        binaries,
        include=[sources],
        flags=["-fvisibility=hidden", *(f"-D{name}=sound_{name}" for name in _WRAPPED)],
    )
    fmu = folder / "flawed.fmu"
    with zipfile.ZipFile(fmu, "w") as archive:
        for path in sorted((folder / "shipped").rglob("*")):
            archive.write(path, path.relative_to(folder / "shipped"))
    shutil.rmtree(folder / "shipped")
    return fmu
