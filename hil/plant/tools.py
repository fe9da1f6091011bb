"""What ``hil fmu check`` finds out: FMPy's validator, and a run of the FMU in a process of its own.

A foreign FMU may crash or hang; that ends one part of the run, and the next one goes on in a new process.
"""

import contextlib
import io
import json
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hil.errors import BadInputError
from hil.plant import archive

_LONGEST_PART_S = 30.0
_LAST_WORDS = 300
_NOT_RUN = "not run, since {} failed"


@dataclass(frozen=True)
class Part:
    """One part of the check: the problems found, and why it was skipped if it was."""

    name: str
    problems: tuple[str, ...] = ()
    skipped: str | None = None


@dataclass(frozen=True)
class CheckResult:
    """All parts of the check, in order."""

    parts: tuple[Part, ...]

    @property
    def problems(self) -> list[str]:
        """Return every problem, one sentence each, after the name of its part; none for a good FMU."""
        return [f"{part.name}: {problem}" for part in self.parts for problem in part.problems]


def check(fmu: Path, longest_s: float = _LONGEST_PART_S) -> CheckResult:
    """Check the archive, the description, and how the FMU behaves when it is run.

    The run is that of ``hil.plant.conformance``, for co-simulation with a library for this platform; without it
    nothing is proven, which is a problem, too. A part that takes longer than ``longest_s`` is a hang. Raises
    BadInputError when the file is no readable FMU.
    """
    archive.read_header(fmu)
    from fmpy.validation import validate_fmu

    from hil.plant.conformance.order import PARTS, title

    names = [title(part) for part in PARTS]
    folder = archive.extract(fmu)
    try:
        found = [" ".join(problem.split()) for problem in validate_fmu(str(folder))]
        description = Part("model description", tuple(found))
        try:
            library = archive.library_of(fmu)
        except BadInputError as error:
            unusable = str(error)
        else:
            if library.interface == "co_simulation":
                run = _run(folder, library, names, longest_s)
                return CheckResult((Part("archive"), description, *run))
            unusable = f"FMU {fmu}: it is for model exchange only, so no call was checked; export it for co-simulation"
        rest = [Part(name, skipped=_NOT_RUN.format("archive")) for name in names]
        return CheckResult((Part("archive", (unusable,)), description, *rest))
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _run(folder: Path, library: archive.Library, names: Sequence[str], longest_s: float) -> list[Part]:
    """Run the parts in child processes, a new one after each crash."""
    from hil.plant.conformance.order import GATES, title

    gates = [title(part) for part in GATES]
    parts: list[Part] = []
    while len(parts) < len(names):
        todo = names[len(parts) :]
        parts += _run_child(folder, library, todo, longest_s)
        if parts[-1].name in gates and parts[-1].problems:
            reason = _NOT_RUN.format(parts[-1].name)
            parts += [Part(name, skipped=reason) for name in names[len(parts) :]]
    return parts


def _run_child(folder: Path, library: archive.Library, todo: Sequence[str], longest_s: float) -> list[Part]:
    """Run the parts ``todo`` until one ends the process; return those that began, at least one."""
    with tempfile.TemporaryDirectory(prefix="hil_fmu_check_") as scratch:
        results = Path(scratch) / "results"
        results.touch()
        command = [sys.executable, "-m", "hil.plant.conformance"]
        command += [str(folder), str(folder / library.member), library.fmi_version, str(results), str(longest_s), *todo]
        end, words = _end_of(command, longest_s * (len(todo) + 1), longest_s)
        parts, trying, done = _read(results)
    if not parts:
        parts = [Part(todo[0])]
    if end is not None or not done:
        where = f" at: {trying}" if trying else ""
        problem = f"the FMU {end or 'ended its process without an error'}{where}{words}"
        parts[-1] = Part(parts[-1].name, (*parts[-1].problems, problem))
    return parts


def _read(results: Path) -> tuple[list[Part], str | None, bool]:
    """Return the parts that began, what was being tried, and whether the last part came to its end."""
    parts: list[Part] = []
    trying, done = None, False
    for line in results.read_text(encoding="utf-8").splitlines():
        entry = json.loads(line)
        if "part" in entry:
            parts.append(Part(entry["part"]))
            trying, done = None, False
        elif "problem" in entry:
            parts[-1] = Part(parts[-1].name, (*parts[-1].problems, entry["problem"]))
        elif "skipped" in entry:
            parts[-1] = Part(parts[-1].name, skipped=entry["skipped"])
        trying = entry.get("trying", trying)
        done = entry.get("done", done)
    return parts, trying, done


def _end_of(command: Sequence[str], longest_s: float, part_s: float) -> tuple[str | None, str]:
    """Run the child to its end; return how it ended when that was not in order, and the last line that it printed."""
    from hil.plant.conformance.order import HUNG

    hung = f"did not return within {part_s:g} s"
    tail = b""

    def listen() -> None:
        nonlocal tail
        assert isinstance(child.stdout, io.BufferedReader)
        with child.stdout as output:
            while piece := output.read1(65536):
                tail = (tail + piece)[-4096:]  # whatever an FMU prints, this stays small

    child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    listener = threading.Thread(target=listen, daemon=True)
    listener.start()
    try:
        child.wait(longest_s)
    except subprocess.TimeoutExpired:  # the child's own watch did not end it
        child.kill()
        child.wait()
        return hung, ""
    listener.join(1.0)  # not for ever: a process that the FMU started may hold the pipe for longer
    lines = tail.decode(errors="replace").strip().splitlines()
    words = f": {lines[-1][:_LAST_WORDS]}" if lines else ""
    if child.returncode == HUNG:
        return hung, words
    if child.returncode < 0:
        return f"crashed its process ({_signal_name(-child.returncode)})", words
    if child.returncode:
        return f"ended its process with the exit code {child.returncode}", words
    return None, words


def _signal_name(number: int) -> str:
    with contextlib.suppress(ValueError):
        return signal.Signals(number).name
    return f"signal {number}"
