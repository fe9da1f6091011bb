"""Python and the packages, against what this package asks for."""

import importlib.metadata
import platform
from collections.abc import Iterator

from packaging.requirements import Requirement

from hil.cli.checks.finding import Finding, ok, problem

DISTRIBUTION = "mecanum-hil"


def check() -> Iterator[Finding]:
    """Yield the version of Python, and the packages that are missing or of another version than wanted."""
    try:
        about = importlib.metadata.metadata(DISTRIBUTION)
    except importlib.metadata.PackageNotFoundError:
        yield problem(
            "versions", f"{DISTRIBUTION} is not installed, so that nothing tells what it needs", "pip install -e ."
        )
        return
    python = platform.python_version()
    wanted = about["Requires-Python"]
    if not wanted or Requirement(f"python{wanted}").specifier.contains(python, prereleases=True):
        yield ok("Python", python)
    else:
        yield problem(
            "Python", f"{python}, where {wanted} is needed", "install a newer Python, and this package into it"
        )
    requirements = [Requirement(text) for text in importlib.metadata.requires(DISTRIBUTION) or ()]
    needed = [one for one in requirements if one.marker is None or one.marker.evaluate({"extra": ""})]
    wrong = [finding for one in needed if (finding := _unmet(one)) is not None]
    if not wrong:
        yield ok("packages", f"all {len(needed)} are there, in versions that fit")
    yield from wrong


def _unmet(requirement: Requirement) -> Finding | None:
    name, wanted = requirement.name, str(requirement.specifier) or "any version"
    remedy = f"pip install '{name}{requirement.specifier}'"
    try:
        version = importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return problem("package", f"{name} is not installed, {wanted} is needed", remedy)
    if requirement.specifier.contains(version, prereleases=True):
        return None
    return problem("package", f"{name} is {version}, {wanted} is needed", remedy)
