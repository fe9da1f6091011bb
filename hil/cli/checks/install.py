"""What is installed: Python, the packages, the native libraries and the plant's FMUs, and a compiler."""

import importlib.metadata
import platform
from collections.abc import Iterator

from packaging.requirements import Requirement

from firmware_protocol.built import WHEEL_HOST, is_checkout, run_script
from hil.cli.checks import Finding, ok, ok_or_note, problem
from hil.core.errors import BadInputError
from hil.core.extensions import OUR_PACKAGE
from hil.core.extras import EXTRAS, missing_of
from hil.plant import archive
from hil.plant.built import COSIM, FMUS, MUJOCO

_NATIVE = (WHEEL_HOST, COSIM, *(built for path, built in FMUS.items() if path != MUJOCO))


def check_versions() -> Iterator[Finding]:
    """Yield the version of Python, and the packages that are missing or have an unsuitable version."""
    try:
        about = importlib.metadata.metadata(OUR_PACKAGE)
    except importlib.metadata.PackageNotFoundError:
        sentence = f"{OUR_PACKAGE} is not installed, so its requirements are not known"
        yield problem("versions", sentence, "pip install -e .")
        return
    python = platform.python_version()
    needed = about["Requires-Python"]
    if not needed or Requirement(f"python{needed}").specifier.contains(python, prereleases=True):
        yield ok("Python", python)
    else:
        remedy = "install a newer Python, and this package into it"
        yield problem("Python", f"{python}, where {needed} is needed", remedy)
    requirements = [Requirement(text) for text in importlib.metadata.requires(OUR_PACKAGE) or ()]
    packages = [one for one in requirements if one.marker is None or one.marker.evaluate({"extra": ""})]
    unmet = [finding for one in packages if (finding := _unmet(one)) is not None]
    if not unmet:
        yield ok("packages", f"all {len(packages)} are installed, in suitable versions")
    yield from unmet
    missing = [extra for extra in EXTRAS if missing_of(extra)]
    there = ", ".join(extra for extra in EXTRAS if extra not in missing) or "none"
    yield ok("extras", there + (f"; not installed: {', '.join(missing)}" if missing else ""))


def _unmet(requirement: Requirement) -> Finding | None:
    name, needed = requirement.name, str(requirement.specifier) or "any version"
    remedy = f"pip install '{name}{requirement.specifier}'"
    try:
        installed = importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return problem("package", f"{name} is not installed, {needed} is needed", remedy)
    if requirement.specifier.contains(installed, prereleases=True):
        return None
    return problem("package", f"{name} is {installed}, {needed} is needed", remedy)


def check_native() -> Iterator[Finding]:
    """Yield the native libraries, the plant FMUs and, in a checkout, the compiler, which only building needs."""
    for built in _NATIVE:
        path = built.path
        subject = "plant" if path.suffix == ".fmu" else "native library"
        remedy = f"python -m {built.module}" if is_checkout(built.root) else "install the package again"
        if not path.is_file():
            yield problem(subject, f"{path.name} is not built", remedy)
        elif not built.is_current():
            yield problem(subject, f"{path.name} was not built from the present sources", remedy)
        elif subject == "plant":
            try:
                yield ok("plant", f"{path.name}, for {', '.join(archive.platforms(path))}")
            except BadInputError as error:
                yield problem("plant", str(error), "hil fmu build")
        else:
            yield ok(subject, path.name)
    if not is_checkout():
        return
    done = run_script("tools.build.compiler")
    remedy = "sudo apt install gcc, or pip install ziglang; only builds need it"
    yield ok_or_note("C compiler", done.returncode == 0, done.stdout.strip(), done.stderr.strip(), remedy)
