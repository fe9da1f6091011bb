"""What is native: whether it was built, of the present sources, and what it can be built with."""

from collections.abc import Iterator
from pathlib import Path

from firmware_protocol.built import WHEEL_HOST, is_checkout, run_script
from hil.cli.checks.finding import Finding, ok, problem
from hil.cli.checks.finding import note as note_of
from hil.core.errors import BadInputError
from hil.plant import archive
from hil.plant.built import COSIM, FMUS, MUJOCO

_NATIVE = (WHEEL_HOST, COSIM, *(built for path, built in FMUS.items() if path != MUJOCO))


def check() -> Iterator[Finding]:
    """Yield the libraries, the plant FMUs and, in a checkout, the compiler: only building needs it."""
    for built in _NATIVE:
        path = built.path
        subject = "plant" if path.suffix == ".fmu" else "native library"
        build = f"python -m {built.module}" if is_checkout(built.root) else "install the package anew"
        if not path.is_file():
            yield problem(subject, f"{path.name} is not built", build)
        elif not built.is_current():
            yield problem(subject, f"{path.name} was not built from the sources beside it", build)
        elif subject == "plant":
            yield from _platforms(path)
        else:
            yield ok(subject, path.name)
    if not is_checkout():
        return
    done = run_script("tools.build.compiler")
    if done.returncode == 0:
        yield ok("C compiler", done.stdout.strip())
    else:
        remedy = "sudo apt install gcc, or pip install ziglang; only builds need it"
        yield note_of("C compiler", done.stderr.strip(), remedy)


def _platforms(fmu: Path) -> Iterator[Finding]:
    try:
        yield ok("plant", f"{fmu.name}, for {', '.join(archive.platforms(fmu))}")
    except BadInputError as error:
        yield problem("plant", str(error), "hil fmu build")
