"""Drive a robot through a service's HTTP API, with Python's own library alone. `hil serve circle_speed` starts one."""

import json
import math
import sys
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path

STATE = Path.home() / ".local/state/mecanum-hil/services"  # where a service on Linux leaves its token


def ask(url: str, token: str, method: str, path: str, body: dict | None = None) -> dict:
    """Send a request and return the answer. A refusal is an HTTPError, whose body says why in a sentence."""
    headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}
    data = b"" if body is None else json.dumps(body).encode()
    with urllib.request.urlopen(urllib.request.Request(url + path, data, headers, method=method)) as answer:
        return json.load(answer)


def main(port: str = "8770", token_file: str | None = None) -> None:
    """Arm the robot, drive it to a pose and a little sideways, and disarm it."""
    url = f"http://127.0.0.1:{port}"
    token = Path(token_file or STATE / f"{port}.token").read_text().strip()

    def order(action: str, **body: float) -> None:
        ask(url, token, "POST", f"/v1/{action}", body or None)

    def wait_until(condition: Callable[[dict], bool]) -> dict:
        while not condition(status := ask(url, token, "GET", "/v1/status")):
            time.sleep(0.05)
        return status

    wait_until(lambda status: status["phase"] == "disarmed")
    order("arm")  # the robot may move from here on, and is held where it stands
    wait_until(lambda status: status["phase"] == "active")
    order("go", x_m=0.6, y_m=0.1, heading_rad=0.5)
    wait_until(lambda status: math.dist(status["pose"], (0.6, 0.1, 0.5)) < 0.005)
    for _ in range(20):  # a twist is in force for 0.2 s: repeat it as long as the robot shall drive
        order("twist", vx_m_s=0.0, vy_m_s=0.2, yaw_rate_rad_s=0.0)
        time.sleep(0.05)
    order("stop")
    status = wait_until(lambda status: status["task"] == "hold" and max(map(abs, status["speed_rad_s"])) < 0.1)
    print("it stands at", status["pose"])
    order("disarm")


if __name__ == "__main__":
    main(*sys.argv[1:])
