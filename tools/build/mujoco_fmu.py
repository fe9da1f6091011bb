"""Compiles the MuJoCo plant for this machine and packs it as an FMU that carries MuJoCo's library.

``python -m tools.build.mujoco_fmu`` builds; with ``--model`` it also writes the robot as a file of MuJoCo's. Needs a C
compiler and the PyPI package ``mujoco``, whose headers and library it takes.
"""

import argparse
import hashlib
import importlib.metadata
import importlib.util
import math
import platform
import sys
import tempfile
from pathlib import Path

from firmware_protocol.built import FLAGS, BuildError
from hil.plant.built import FMUS, MUJOCO
from plant_fmu import c_header, description, generate, platforms, tables
from plant_fmu.mujoco import definition
from plant_fmu.mujoco.model import ModelError, save
from plant_fmu.sources import HERE as SHARED
from plant_fmu.sources import MUJOCO as HERE
from plant_fmu.sources import MUJOCO_HEADERS as HEADERS
from plant_fmu.sources import MUJOCO_SOURCES as SOURCES
from plant_fmu.sources import comment_of
from tools.build import pack
from tools.build.compiler import compile_shared, compiler, version

LICENSE = SHARED / "documentation" / "licenses" / "license.txt"
PAGE, TABLE = HERE / "documentation.html", "<!-- variables -->"


def build(out: Path | None = None, cc: str | None = None) -> Path:
    """Build the FMU unless it is up to date, and return its path.

    Raises BuildError when MuJoCo or a C compiler is missing, when compiling fails, and when ``out`` cannot be
    written.
    """
    out = MUJOCO if out is None else out
    package = _package()
    library = _library(package)
    variables = definition.read()
    guid = generate.guid(variables)
    texts = {
        "modelDescription.xml": description.model_description(variables, 2, guid),
        "mecanum_variables.h": c_header.c_header(variables, guid),
        "documentation/index.html": PAGE.read_text(encoding="utf-8").replace(TABLE, tables.html_tables(variables)),
    }
    inputs = f"{_digest(compiler(cc), library, texts)} {FMUS[MUJOCO].digest()}"
    if comment_of(out) == inputs:
        return out
    with tempfile.TemporaryDirectory(prefix="plant_fmu_mujoco_") as folder:
        header = Path(folder) / "mecanum_variables.h"
        header.write_text(texts.pop(header.name), encoding="utf-8")
        identifier = variables.model["name"]
        binary = Path(folder) / f"{identifier}{platforms.suffix(platforms.this_platform())}"
        # MuJoCo lies next to the binary, wherever that is unpacked.
        beside = "@loader_path" if sys.platform == "darwin" else "$ORIGIN"
        flags = (
            '-DPLANT_STATE_HEADER="state.h"',
            f"-isystem{package / 'include'}",
            f"-Wl,-rpath,{beside}",
        )
        compile_shared((*SOURCES, library), binary, include=(HERE, SHARED, header.parent), cc=cc, flags=flags)
        binaries = platforms.members(2, identifier, {platforms.this_platform(): binary.read_bytes()})
        beside_binaries = {f"{name.rpartition('/')[0]}/{library.name}": library.read_bytes() for name in binaries}
        members = {
            **{name: text.encode() for name, text in texts.items()},
            **binaries,
            **beside_binaries,
            "documentation/licenses/license.txt": LICENSE.read_bytes(),
            **_licenses(),
        }
    try:
        pack.write(members, out, inputs)
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
    digest = hashlib.sha256(repr((command[1:], version(command), FLAGS, platform.machine(), texts)).encode())
    modules = (Path(str(module.__file__)) for module in (sys.modules[__name__], pack, platforms))
    for path in (*modules, library, LICENSE, *SOURCES, *HEADERS):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    for name, content in sorted(_licenses().items()):
        digest.update(name.encode() + b"\0" + content + b"\0")
    return digest.hexdigest()


def setting(text: str) -> tuple[str, float]:
    """Return name and value of ``name=value``. Raises ValueError, which argparse reports."""
    name, _, value = text.partition("=")
    if not math.isfinite(float(value)):
        raise ValueError
    return name, float(value)


def main() -> None:
    """Build the FMU and print its path, and the model's."""
    parser = argparse.ArgumentParser(
        prog="tools.build.mujoco_fmu", description="Build the MuJoCo plant for this machine."
    )
    parser.add_argument("--out", type=Path, help="the FMU to write; the package's own by default")
    parser.add_argument("--model", type=Path, help="also write the robot for MuJoCo's viewer: a file .xml or .mjb")
    parser.add_argument(
        "--set",
        type=setting,
        action="append",
        default=[],
        metavar="NAME=VALUE",
        dest="parameters",
        help="a parameter of that robot, such as wheel_radius_m=0.05",
    )
    arguments = parser.parse_args()
    if arguments.parameters and arguments.model is None:
        parser.error("--set is for --model; the FMU takes its parameters when it runs")
    try:
        fmu = build(arguments.out)
        print(fmu)
        if arguments.model is not None:
            save(fmu, arguments.model, dict(arguments.parameters))
            print(arguments.model)
    except (BuildError, ModelError) as error:
        sys.exit(f"tools.build.mujoco_fmu: {error}")


if __name__ == "__main__":
    main()
