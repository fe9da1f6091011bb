"""What is native: whether it was built, of the present sources, and what it can be built with."""

from collections.abc import Iterator
from pathlib import Path

import firmware_protocol.build
import hil.plant.build
from hil.doctor.finding import Finding, ok, problem
from hil.doctor.finding import note as note_of
from hil.errors import BadInputError
from hil.plant import archive
from native_build.compiler import BuildError, compiler, version

_CHECKOUT = Path(__file__).parents[2] / "pyproject.toml"
_LIBRARIES = {
    "firmware_protocol.build": (firmware_protocol.build.LIBRARY, firmware_protocol.build.is_fresh),
    "hil.plant.build": (hil.plant.build.LIBRARY, hil.plant.build.is_fresh),
}


def check() -> Iterator[Finding]:
    """Yield the libraries, the plant FMU, and the compiler, which only who builds anew needs."""
    for module, (library, is_fresh) in _LIBRARIES.items():
        build = f"python -m {module}"
        if not library.exists():
            yield problem("native library", f"{library.name} is not built", build)
        elif _CHECKOUT.exists() and not is_fresh():
            yield problem("native library", f"{library.name} is older than its sources", build)
        else:
            yield ok("native library", library.name)
    try:
        fmu = archive.locate("mecanum", Path())
        yield ok("plant", f"{fmu.name}, for {', '.join(archive.platforms(fmu))}")
    except BadInputError as error:
        yield problem("plant", str(error), "hil fmu build")
    try:
        command = compiler()
        yield ok("C compiler", version(command))
    except BuildError as error:
        yield note_of("C compiler", str(error), "sudo apt install gcc, or pip install ziglang; only builds need it")
