"""A client example: sends pose fixes to a run that has ``estimator.fix = "udp://127.0.0.1:PORT"``.

Reads one pose a line from standard input, ``unix_time_s x_m y_m heading_rad``, and sends each at once as a message of
version 1 (hil/estimation/ESTIMATORS.md). A time of ``now`` stands for the present. A line that is no pose is skipped;
how many were is said at the end. Each message has the token of the port, from a file of this user, which whoever of
client and run begins first makes. It needs Python's own library alone; put in its place whatever your localisation
gives::

    my_slam | python tools/pose_fix_client.py --port 5005 --sigma-m 0.02 --sigma-rad 0.01
"""

import argparse
import contextlib
import json
import math
import os
import secrets
import socket
import sys
import time
from pathlib import Path


def token_at(port: int) -> Path:
    """Return the file with the token of this user's receiver at a port; it is made if it is not there (Linux)."""
    state = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local/state")
    file = state / f"mecanum-hil/fixes/{port}.token"
    if not file.exists():
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        new = file.with_name(f".{port}.{os.getpid()}")
        new.touch(0o600)
        new.write_text(secrets.token_urlsafe(32))
        with contextlib.suppress(FileExistsError):  # the receiver has made it meanwhile
            os.link(new, file)
        new.unlink()
    return file


def datagram(
    token: str, unix_time_s: float, x_m: float, y_m: float, heading_rad: float, sigma_m: float, sigma_rad: float
) -> bytes:
    """Return the message: the pose in the world frame, and its covariance, upper triangle of (x, y, heading)."""
    message = {
        "version": 1,
        "token": token,
        "unix_time_s": unix_time_s,
        "x_m": x_m,
        "y_m": y_m,
        "heading_rad": heading_rad,
        "covariance": [sigma_m**2, 0.0, 0.0, sigma_m**2, 0.0, sigma_rad**2],
    }
    return json.dumps(message).encode("utf-8")


def pose_of(line: str) -> tuple[float, float, float, float]:
    """Return the time and the pose that a line says. Raises ValueError for a line that says none."""
    stamp, *words = line.split()
    x_m, y_m, heading_rad = map(float, words)
    pose = (time.time() if stamp == "now" else float(stamp), x_m, y_m, heading_rad)
    if not all(map(math.isfinite, pose)):
        raise ValueError("not finite")
    return pose


def main() -> int:
    """Send until standard input ends; return 1 when a line was skipped."""
    parser = argparse.ArgumentParser(
        description="Send pose fixes, one a line of standard input: unix_time_s x_m y_m heading_rad. "
        "In place of unix_time_s, 'now' stands for the present."
    )
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, required=True)
    parser.add_argument("--sigma-m", type=float, default=0.02, help="standard deviation of x and of y")
    parser.add_argument("--sigma-rad", type=float, default=0.01, help="standard deviation of the heading")
    parser.add_argument("--token-file", type=Path, help="by default that of this user's receiver at the port")
    options = parser.parse_args()
    token_file = options.token_file or token_at(options.port)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        skipped = 0
        for number, line in enumerate(sys.stdin, start=1):
            try:
                data = datagram(token_file.read_text().strip(), *pose_of(line), options.sigma_m, options.sigma_rad)
            except ValueError:
                if not skipped:
                    print(f"line {number} is skipped: expected unix_time_s x_m y_m heading_rad", file=sys.stderr)
                skipped += 1
                continue
            sender.sendto(data, (options.host, options.port))
    if skipped:
        print(f"lines skipped: {skipped}", file=sys.stderr)
    return 1 if skipped else 0


if __name__ == "__main__":
    sys.exit(main())
