"""What is native: whether it was built, of the present sources, and what it can be built with."""

from collections.abc import Iterator
from pathlib import Path

import firmware_protocol.build
import hil.plant.build
import plant_fmu.built
from hil.cli.checks.finding import Finding, ok, problem
from hil.cli.checks.finding import note as note_of
from hil.core.errors import BadInputError
from hil.plant import archive
from native_build.compiler import BuildError, compiler, version

_NATIVE = (firmware_protocol.build.BUILT, hil.plant.build.BUILT, *plant_fmu.built.BUILT.values())


def check() -> Iterator[Finding]:
    """Yield the libraries, the plant FMUs, and the compiler, which only who builds anew needs."""
    for built in _NATIVE:
        path = built.path
        subject = "plant" if path.suffix == ".fmu" else "native library"
        build = f"python -m {built.module}" if built.is_checkout() else "install the package anew"
        if not path.is_file():
            yield problem(subject, f"{path.name} is not built", build)
        elif not built.is_current():
            yield problem(subject, f"{path.name} was not built from the sources beside it", build)
        elif subject == "plant":
            yield from _platforms(path)
        else:
            yield ok(subject, path.name)
    try:
        command = compiler()
        yield ok("C compiler", version(command))
    except BuildError as error:
        yield note_of("C compiler", str(error), "sudo apt install gcc, or pip install ziglang; only builds need it")


def _platforms(fmu: Path) -> Iterator[Finding]:
    try:
        yield ok("plant", f"{fmu.name}, for {', '.join(archive.platforms(fmu))}")
    except BadInputError as error:
        yield problem("plant", str(error), "hil fmu build")
