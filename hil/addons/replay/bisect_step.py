"""A step of a bisection, which ``git bisect run`` calls in a work tree: a replay with the code that is checked out.

It is run by its path and imports nothing of this project, whose older version may be the one that is looked at. The
result is written beside those of the other commits. Exit code 0: equal; 1: different; 125: this commit cannot tell.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

CANNOT_TELL = 125


def main(results: str, root: str, place: str, *replay: str) -> int:
    """Replay in the folder ``place`` of the work tree ``root``; ``replay`` are the arguments of ``hil replay``."""
    head = ["git", "-C", root, "rev-parse", "HEAD"]
    commit = subprocess.run(head, capture_output=True, text=True, check=True).stdout.strip()
    environment = os.environ | {"PYTHONPATH": root}
    command = [sys.executable, "-P", "-m", "hil", "replay", *replay, "--json"]
    done = subprocess.run(
        command, cwd=place, env=environment, capture_output=True, text=True, errors="replace", check=False
    )
    if done.returncode not in (0, 1):
        why = done.stderr.strip().rpartition("\n")[2]
        print(f"{commit[:12]}: skipped, {why}", file=sys.stderr)
        return CANNOT_TELL
    found = json.loads(done.stdout)
    Path(results, commit).write_text(done.stdout, encoding="utf-8")
    words = "equal" if found["equal"] else f"different, {found['part']} first"
    print(f"{commit[:12]}: {words}", file=sys.stderr)
    return done.returncode


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
