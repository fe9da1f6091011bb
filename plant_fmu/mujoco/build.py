"""Compiles the MuJoCo plant for this machine and packs it as an FMU that carries MuJoCo's library.

Needs the standard library, a C compiler and the PyPI package ``mujoco``, whose headers and library it takes.
"""

import hashlib
import importlib.metadata
import importlib.util
import platform
import sys
import tempfile
from pathlib import Path

from plant_fmu import build as packing
from plant_fmu import generate, mujoco
from plant_fmu.build import BuildError
from plant_fmu.mujoco import definition

HERE = Path(__file__).parent
SHARED = HERE.parent
SOURCES = (SHARED / "fmi2.c", SHARED / "instance.c", HERE / "physics.c", HERE / "robot.c")
HEADERS = (SHARED / "fmi2.h", SHARED / "instance.h", SHARED / "physics.h", HERE / "robot.h", HERE / "state.h")
LICENSE = SHARED / "documentation" / "licenses" / "license.txt"
PAGE, TABLE = HERE / "documentation.html", "<!-- variables -->"


def build(out: Path | None = None, cc: str | None = None) -> Path:
    """Build the FMU unless it is up to date, and return its path.

    Raises BuildError when MuJoCo or a C compiler is missing, when compiling fails, and when ``out`` cannot be
    written.
    """
    out = mujoco.path() if out is None else out
    package = _package()
    library = _library(package)
    variables = definition.read()
    texts = {
        "modelDescription.xml": generate.model_description(variables),
        "mecanum_variables.h": generate.c_header(variables),
        "documentation/index.html": PAGE.read_text(encoding="utf-8").replace(TABLE, generate.html_table(variables)),
    }
    inputs = _digest(packing.compiler(cc), library, texts)
    if packing._is_made_from(out, inputs):
        return out
    with tempfile.TemporaryDirectory(prefix="plant_fmu_mujoco_") as folder:
        header = Path(folder) / "mecanum_variables.h"
        header.write_text(texts.pop(header.name), encoding="utf-8")
        binary = Path(folder) / f"{variables.model['name']}{packing.SUFFIX}"
        # MuJoCo lies next to the binary, wherever that is unpacked.
        beside = "@loader_path" if sys.platform == "darwin" else "$ORIGIN"
        flags = (
            "-fvisibility=hidden",
            '-DPLANT_STATE_HEADER="state.h"',
            f"-isystem{package / 'include'}",
            f"-Wl,-rpath,{beside}",
        )
        packing.compile_shared((*SOURCES, library), binary, include=(HERE, SHARED, header.parent), cc=cc, flags=flags)
        binaries = f"binaries/{packing.binaries_folder()}"
        members = {
            **{name: text.encode() for name, text in texts.items()},
            f"{binaries}/{binary.name}": binary.read_bytes(),
            f"{binaries}/{library.name}": library.read_bytes(),
            "documentation/licenses/license.txt": LICENSE.read_bytes(),
            **_licenses(),
        }
    try:
        packing._pack(members, out, inputs)
    except OSError as error:
        raise BuildError(f"{out}: cannot be written ({error.strerror}); choose another file") from error
    return out


def _package() -> Path:
    """Return the folder of the installed MuJoCo."""
    found = importlib.util.find_spec("mujoco")
    if found is None or found.origin is None:
        raise BuildError('MuJoCo is not installed; run: pip install "mecanum-hil[mujoco]"')
    return Path(found.origin).parent


def _library(package: Path) -> Path:
    pattern = {"linux": "libmujoco.so.*", "darwin": "libmujoco.*.dylib"}.get(sys.platform)
    if pattern is None:
        raise BuildError("the MuJoCo plant is built on Linux and macOS only; copy the FMU from there or use WSL")
    libraries = sorted(package.glob(pattern))
    if not libraries:
        raise BuildError(f"{package} has no {pattern}; install MuJoCo from PyPI: pip install --force-reinstall mujoco")
    return libraries[-1]


def _licenses() -> dict[str, bytes]:
    """Return MuJoCo's licence and those of what it contains, as its package states them."""
    files = importlib.metadata.files("mujoco") or []
    texts = [Path(str(file.locate())) for file in files if "licenses" in file.parts]
    if not texts:
        raise BuildError("the installed MuJoCo states no licence; install it from PyPI")
    return {f"documentation/licenses/mujoco/{text.name}": text.read_bytes() for text in texts}


def _digest(command: list[str], library: Path, texts: dict[str, str]) -> str:
    """Return a hash of all that the FMU is made from."""
    digest = hashlib.sha256(repr((command, packing.FLAGS, platform.machine(), texts)).encode())
    for path in (Path(__file__), library, LICENSE, *SOURCES, *HEADERS):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()
