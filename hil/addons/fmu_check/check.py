"""What ``hil fmu check`` does: FMPy's validator, and a run of the FMU in a process of its own.

A foreign FMU may crash or hang. That ends one part of the run; the next part runs in a new process.
"""

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hil.addons.fmu_check import Finding, Kind, violation
from hil.addons.fmu_check.parts import GATES, PARTS, title
from hil.core.errors import BadInputError
from hil.core.subprocesses import DEFAULT_LIMIT_MB
from hil.plant import archive, shim
from hil.plant.child_output import one_line
from hil.plant.description import import_fmpy, read_description
from hil.plant.process import THERE_S, ChildProcess, Watch

_LONGEST_CALL_S = 30.0
_NOT_RUN = "not run, since {} failed"


@dataclass(frozen=True)
class Part:
    """One part of the check: what was found, and why it was skipped if it was."""

    name: str
    findings: tuple[Finding, ...] = ()
    skipped: str | None = None

    def having(self, finding: Finding) -> "Part":
        """Return the part with one finding more."""
        return replace(self, findings=(*self.findings, finding))


@dataclass(frozen=True)
class CheckResult:
    """All parts of the check, in order."""

    parts: tuple[Part, ...]

    @property
    def violations(self) -> list[str]:
        """Return every violation of the standard; none for a good FMU."""
        return self.texts(Kind.VIOLATION)

    def texts(self, kind: Kind) -> list[str]:
        """Return the findings of a kind, one sentence each, which begins with the name of the part."""
        return [f"{part.name}: {one.text}" for part in self.parts for one in part.findings if one.kind == kind]


def check(fmu: Path, longest_s: float = _LONGEST_CALL_S, say: Callable[[str], object] = lambda _: None) -> CheckResult:
    """Check the archive, the description, and how the FMU behaves when it is run.

    The run is that of ``hil.addons.fmu_check``. A call of the FMU that takes longer than ``longest_s`` is a hang.
    Its process is ended at 2000 MB. ``say`` is given the name of each part before it begins.

    Raises BadInputError when the file is no readable FMU or cannot be run here: it is of another version, or without
    co-simulation, a library for this platform or a library that this one needs. Raises DeviceError when no process can
    be started.
    """
    archive.read_header(fmu)
    shim.load()  # the child needs it: raise here what is missing
    archive.check_may_load(fmu)
    say("archive")
    broken = []
    try:
        library = archive.library_of(fmu)
        read_description(fmu)
    except archive.BrokenFmuError as error:
        broken.append(violation(str(error)))
    with archive.extract(fmu) as folder:
        say("model description")
        description = _validated(folder)
        if broken:
            rest = [Part(title(part), skipped=_NOT_RUN.format("archive")) for part in PARTS]
            return CheckResult((Part("archive", tuple(broken)), description, *rest))
        job = {
            "fmu": str(fmu.absolute()),
            "library": str(folder / library.member),
            "version": library.fmi_version,
            "parts": [title(part) for part in PARTS],
        }
        return CheckResult((Part("archive"), description, *_run(job, folder, longest_s, say)))


def _validated(folder: Path) -> Part:
    """Return the findings of FMPy's validator."""
    import_fmpy()
    from fmpy.validation import validate_fmu

    return Part("model description", tuple(violation(one_line(problem)) for problem in validate_fmu(str(folder))))


def _run(job: Mapping[str, Any], folder: Path, longest_s: float, say: Callable[[str], object]) -> list[Part]:
    """Run the parts in child processes, a new one after each crash."""
    parts: list[Part] = []
    while todo := job["parts"][len(parts) :]:
        parts += _run_child({**job, "parts": todo}, folder, longest_s, say)
        if parts[-1].name in map(title, GATES) and parts[-1].findings:
            reason = _NOT_RUN.format(parts[-1].name)
            parts += [Part(name, skipped=reason) for name in job["parts"][len(parts) :]]
    return parts


def _run_child(job: Mapping[str, Any], folder: Path, longest_s: float, say: Callable[[str], object]) -> list[Part]:
    """Run the parts of a job until one ends the process; return those that began, at least one."""
    progress = _Progress()
    received = 0
    with contextlib.ExitStack() as resources:
        child = ChildProcess("hil.addons.fmu_check", folder)
        resources.callback(child.close, 0.0)
        watch = Watch(lambda: received, child.give_up, longest_s, lambda: child.limit_memory(DEFAULT_LIMIT_MB))
        resources.callback(watch.stop)
        watch.limit_s = THERE_S
        child.send(job)
        for entry in child.receive_all():
            if "refused" in entry:
                raise BadInputError(f"FMU {job['fmu']}: {entry['refused']}")
            received += 1
            progress.add(entry)
            if "part" in entry:
                say(entry["part"])
            watch.limit_s = longest_s if progress.parts else THERE_S
        if child.wait() == 0 and progress.is_done:
            return progress.parts
        ending = f"{progress.place}{child.ending()}"
    *before, last = progress.parts or [Part(job["parts"][0])]
    return [*before, last.having(violation(ending))]


class _Progress:
    """The parts that a child has begun so far, and its current call."""

    def __init__(self) -> None:
        self.parts: list[Part] = []
        self.is_done = False  # with the newest part
        self._call = ""

    @property
    def place(self) -> str:
        """Return the newest call, as the beginning of a sentence."""
        return f"{self._call}, " if self._call else ""

    def add(self, entry: Mapping[str, Any]) -> None:
        """Add a record of the child."""
        if "part" in entry:
            self.parts.append(Part(entry["part"]))
            self.is_done, self._call = False, ""
        if "found" in entry:
            self.parts[-1] = self.parts[-1].having(Finding(Kind(entry["kind"]), entry["found"]))
        if "skipped" in entry:
            self.parts[-1] = replace(self.parts[-1], skipped=entry["skipped"])
        self._call = entry.get("doing", self._call)
        self.is_done = entry.get("done", self.is_done)
