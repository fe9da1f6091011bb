"""Types the start page into an empty Debian: ``python -m tools.start_page`` as root, in some minutes.

It makes a Debian in a temporary folder with the packages of the page's first paragraph, and puts a wheel into ``dist``.
It types each command of ``docs/start.md`` into a shell whose root is that folder. What the page shows has to appear.
Python's packages come from where this machine's pip takes them; ``--bind`` shows it a folder that pip's settings name.
"""

import argparse
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tools.debian import make_debian
from tools.page_blocks import GIT, PageError, run_page

ROOT = Path(__file__).parents[1]
_SUITE, _PACKAGES = "bookworm", "python3-venv,git,ca-certificates"
_BOUND = ("/dev", "/proc", "/etc/resolv.conf")


def main() -> None:
    """Make the Debian, and run the page in it."""
    parser = argparse.ArgumentParser(prog="tools.start_page", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("dist", type=Path, nargs="?", help="folder with the wheel; without it one is built")
    parser.add_argument("--bind", action="append", default=[], metavar="PATH", help="show this folder there")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="hil_start_", ignore_cleanup_errors=True) as folder:
        root = make_debian(Path(folder, "debian"), _PACKAGES, suite=_SUITE, variant="apt")
        if options.dist is None:
            wheel = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", str(ROOT)]
            subprocess.run([*wheel, "--wheel-dir", str(root / "root" / "dist")], check=True)
        else:
            shutil.copytree(options.dist, root / "root" / "dist")
        print(f"{page_in(root, options.bind):.0f} s for the whole page, in an empty Debian {_SUITE}")


def page_in(root: Path, bound: list[str]) -> float:
    """Type the start page into a shell below ``root``; return how long it took. The mounts end with the shell."""
    steps = ["mount --make-rprivate /"]
    for path in (*_BOUND, *bound):
        place = root / path.lstrip("/")
        if Path(path).is_dir():
            place.mkdir(parents=True, exist_ok=True)
        else:
            place.touch()
        steps.append(f"mount --rbind {shlex.quote(path)} {shlex.quote(str(place))}")
    steps.append(f"exec chroot {shlex.quote(str(root))} bash -c 'cd && exec bash'")
    settings = {name: value for name, value in os.environ.items() if name.startswith("PIP_")}
    there = {"HOME": "/root", "PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "LANG": "C.UTF-8", "COLUMNS": "80"}
    shell = ["unshare", "--mount", "sh", "-ec", "\n".join(steps)]
    begun_s = time.monotonic()
    try:
        run_page(ROOT / "docs" / "start.md", Path("/"), settings | GIT | there, shell, root)
    except PageError as error:
        raise SystemExit(str(error)) from None
    return time.monotonic() - begun_s


if __name__ == "__main__":
    main()
