"""A client example: sends pose fixes to a run that has ``estimator.fix = "udp://127.0.0.1:PORT"``.

Reads one pose a line from standard input, ``unix_time_s x_m y_m heading_rad``, and sends each at once as a message of
version 1 (hil/estimator/ESTIMATORS.md). A time of ``now`` stands for the present. It needs Python's own library alone;
put in its place whatever your localisation gives::

    my_slam | python tools/pose_fix_client.py --port 5005 --sigma-m 0.02 --sigma-rad 0.01
"""

import argparse
import json
import socket
import sys
import time


def datagram(unix_time_s: float, x_m: float, y_m: float, heading_rad: float, sigma_m: float, sigma_rad: float) -> bytes:
    """Return the message: the pose in the world frame, and its covariance, upper triangle of (x, y, heading)."""
    message = {
        "version": 1,
        "unix_time_s": unix_time_s,
        "x_m": x_m,
        "y_m": y_m,
        "heading_rad": heading_rad,
        "covariance": [sigma_m**2, 0.0, 0.0, sigma_m**2, 0.0, sigma_rad**2],
    }
    return json.dumps(message).encode("utf-8")


def main() -> None:
    """Send until standard input ends."""
    parser = argparse.ArgumentParser(description="Send pose fixes, one a line: unix_time_s x_m y_m heading_rad")
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, required=True)
    parser.add_argument("--sigma-m", type=float, default=0.02, help="standard deviation of x and of y")
    parser.add_argument("--sigma-rad", type=float, default=0.01, help="standard deviation of the heading")
    options = parser.parse_args()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for line in sys.stdin:
            stamp, *pose = line.split()
            x_m, y_m, heading_rad = map(float, pose)
            unix_time_s = time.time() if stamp == "now" else float(stamp)
            data = datagram(unix_time_s, x_m, y_m, heading_rad, options.sigma_m, options.sigma_rad)
            sender.sendto(data, (options.host, options.port))


if __name__ == "__main__":
    main()
