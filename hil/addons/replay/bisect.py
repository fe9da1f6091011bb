"""Which commit made a controller differ from a recording: ``git bisect run`` in a work tree of its own.

The work tree may be that of a robot's repository, with its law and scenarios, or of this project: its packages are then
those of each commit, and native libraries are built for it.
"""

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from hil.addons.replay import bisect_step
from hil.core.errors import BadInputError, DeviceError
from hil.core.scratch import scratch_folder
from hil.judge.recorded import scenario_of
from hil.record.reader import read


class Culprit(NamedTuple):
    """The first commit that differs: its hash and subject, and the comparison of its replay, as JSON values."""

    commit: str
    subject: str
    found: dict[str, Any]


def bisect(span: str, recording: Path, arguments: Sequence[str] = ()) -> Culprit:
    """Return the first commit of ``span`` (``GOOD..BAD``) whose controller differs from a recording.

    ``arguments`` are further ones of ``hil replay``. Progress is printed on standard error, a line a commit. Raises
    BadInputError where the present folder is in no repository, for commits that do not exist, and unless GOOD is equal
    and BAD differs; DeviceError where no commit can be named because those beside it cannot be replayed.
    """
    good, dots, bad = span.partition("..")
    if not (good and dots and bad):
        raise BadInputError(f"--bisect {span}: expected GOOD..BAD, two commits, as in v1.2..main")
    here = Path.cwd().resolve()
    root = Path(_git(here, "rev-parse", "--show-toplevel"))
    commits = {name: _git(root, "rev-parse", "--verify", f"{name}^{{commit}}") for name in (good, bad)}
    with scratch_folder("bisect") as scratch:
        tree, results = scratch / "tree", scratch / "results"
        results.mkdir()
        _git(root, "worktree", "add", "--quiet", "--detach", str(tree), commits[bad])
        try:
            place = tree / here.relative_to(root)
            arguments = [*_law_of_commit(recording, root, tree), *arguments]
            step = [sys.executable, bisect_step.__file__, str(results), str(tree), str(place), str(recording.resolve())]
            step += arguments
            for name, expected in ((bad, 1), (good, 0)):
                _git(tree, "checkout", "--quiet", commits[name])
                _check(name, subprocess.run(step, check=False).returncode, expected)
            _git(tree, "bisect", "start", commits[bad], commits[good])
            subprocess.run(["git", "bisect", "run", *step], cwd=tree, stdout=subprocess.DEVNULL, check=False)
            if "only skipped commits" in _git(tree, "bisect", "log"):
                raise DeviceError(
                    f"--bisect {span}: the commits between the last that is equal and the first that differs cannot be "
                    "replayed; their lines above say why"
                )
            commit = _git(tree, "rev-parse", "refs/bisect/bad")
            subject = _git(tree, "log", "-1", "--format=%s", commit)
            return Culprit(commit, subject, json.loads((results / commit).read_text("utf-8")))
        finally:
            _git(root, "worktree", "remove", "--force", str(tree))


def _law_of_commit(recording: Path, root: Path, tree: Path) -> list[str]:
    """Return the option by which the law of a recorded run is that of the commit, if its file is in the repository."""
    law = str(scenario_of(read(recording, [])).get("controller.law", ""))
    file, colon, name = law.rpartition(":")
    if not colon or not Path(file).is_relative_to(root):
        return []
    return ["--set", f"controller.law={tree / Path(file).relative_to(root)}:{name}"]


def _check(name: str, code: int, expected: int) -> None:
    if code == bisect_step.CANNOT_TELL:
        raise BadInputError(f"--bisect: {name} cannot be replayed; the line above says why")
    if code != expected:
        words = "is equal already, so nothing differs up to it" if code == 0 else "differs already; name an older one"
        raise BadInputError(f"--bisect: {name} {words}")


def _git(folder: Path, *words: str) -> str:
    done = subprocess.run(["git", *words], cwd=folder, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode:
        why = done.stderr.strip().rpartition("\n")[2].removeprefix("fatal: ")
        raise BadInputError(f"--bisect: git {words[0]}: {why}")
    return done.stdout.strip()
