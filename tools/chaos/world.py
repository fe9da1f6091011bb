"""The processes: a virtual robot, the service that drives it, its children, and a viewer."""

import contextlib
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, Self

import psutil

from hil.addons.service.client import Client
from hil.addons.service.discovery import running
from hil.core.errors import HilError
from hil.core.process_lock import held
from hil.core.tokens import state_folder
from tools.chaos.line import Line

WAIT_S = 40.0
_ROLES = {
    "hil.record.recorder": "recorder",
    "hil.addons.service.api_child": "api",
    "hil.addons.service.api_process": "api",
    "hil.addons.service.estop_process": "estop",
    "hil.addons.motors.guardian_process": "guardian",
}


class Kind(NamedTuple):
    """A world: the scenario, what is set in it, and whether a bad line can be put between host and robot."""

    scenario: str
    sets: tuple[str, ...]
    has_line: bool


KINDS = {
    "firmware": Kind("circle_speed", ("loop.rate_hz=100",), has_line=True),
    # A board that knows no time limit: a guardian stops it when the host dies.
    "board": Kind(
        "circle_speed",
        ("loop.rate_hz=100", "device.driver=rosmaster", "plant.start.battery_voltage_v=12"),
        has_line=False,
    ),
}


class World:
    """One robot and one service in a folder of their own. Everything that they leave must be in it."""

    def __init__(self, kind: Kind, folder: Path, rng: random.Random) -> None:
        self.kind, self.folder = kind, folder
        for name in ("tmp", "state", "runs"):
            (folder / name).mkdir(parents=True)
        self._clock = folder / "clock"
        self.step_clock(0.0)
        self._clock_library = _built_clock(folder)
        # Where services and the truth leave their tokens, and we find them.
        os.environ["XDG_STATE_HOME"] = str(folder / "state")
        self._environment = {**os.environ, "HIL_CHAOS": str(folder), "TMPDIR": str(folder / "tmp")}
        self.viewer: subprocess.Popen[bytes] | None = None
        self._log = (folder / "log.jsonl").open("ab")
        self.live_port = _free_port()
        self.robot: subprocess.Popen[bytes]
        self.truth = ""
        self.start_robot()
        self.line = Line(folder / "robot", rng) if kind.has_line else None
        self.services, self._served = 0, 0
        self.service = self.start_service()

    @property
    def moves_time(self) -> bool:
        """Whether the service's time of day can be moved: on Linux with a C compiler."""
        return self._clock_library is not None

    def step_clock(self, by_s: float) -> None:
        """Move the time of day of the service and its children, and of nothing else."""
        with self._clock.open("r+b" if self._clock.exists() else "wb") as file:
            file.write(int(by_s).to_bytes(8, sys.byteorder, signed=True))

    def start_service(self) -> "subprocess.Popen[bytes]":
        """Start the service, as systemd would."""
        link = self.line.url if self.line is not None else f"serial:{self.folder / 'robot'}"
        words = ["serve", self.kind.scenario, "--link", link, "--record", "run.rrd", "--log", "json"]
        words += ["--live", "--live-port", str(self.live_port), "--allow-motion"]
        for setting in (*self.kind.sets, "estimator.source=odometry", "service.port=0"):
            words += ["--set", setting]
        environment = dict(self._environment)
        if self._clock_library is not None:
            environment |= {"LD_PRELOAD": str(self._clock_library), "HIL_CHAOS_CLOCK": str(self._clock)}
        self.services += 1
        self.service = subprocess.Popen(
            [sys.executable, "-m", "hil", *words],
            cwd=self.folder,
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=self._log,
            start_new_session=True,
        )
        return self.service

    def restart_service(self) -> str | None:
        """Restart a service that ended on its own; return the error of its end.

        One that could not start, as its recorder was killed (3) or the disk was full (2), may say so and end.
        """
        code, has_served = self.service.returncode, self._served == self.service.pid
        self.start_service()
        return None if code in (2, 3) and not has_served else f"the service ended with exit code {code}"

    def start_robot(self) -> None:
        """Start the robot. Raises RuntimeError when it does not come up."""
        words = ["device", self.kind.scenario, "--mode", "realtime", "--link", "serial:pty?symlink=robot"]
        for setting in self.kind.sets:
            words += ["--set", setting]
        self.robot = subprocess.Popen(
            [sys.executable, "-m", "hil", *words],
            cwd=self.folder,
            env=self._environment,
            stdout=subprocess.PIPE,
            stderr=(self.folder / "robot.log").open("ab"),
            start_new_session=True,
        )
        assert self.robot.stdout is not None
        ready = self.robot.stdout.readline().decode()
        if "truth=" not in ready:
            raise RuntimeError(f"the robot did not start: {ready!r}; see {self.folder / 'robot.log'}")
        self.truth = ready.partition("truth=")[2].split()[0]

    def kill_robot(self) -> None:
        """Kill the robot's process, as when a board is unplugged. The truth of the next one is at another address."""
        self.truth = ""
        # First: the terminal's number is free afterwards, and the line would open a terminal of some other robot.
        (self.folder / "robot").unlink(missing_ok=True)
        self.robot.kill()
        self.robot.communicate()

    def start_viewer(self) -> None:
        """Start the viewer of the live signals, in the browser's form: no window."""
        self.viewer = subprocess.Popen(
            [sys.executable, "-m", "hil", "live", "--web", "--port", str(self.live_port)],
            cwd=self.folder,
            env={**self._environment, "BROWSER": "true"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    def client(self) -> Client | None:
        """Return a client of the running service; None while there is none."""
        found = running()
        if len(found) != 1:
            return None
        self._served = found[0].pid
        try:
            return Client(found[0].url, Path(found[0].token_file), found[0].estop_url)
        except HilError:  # it is gone
            return None

    def processes(self) -> dict[str, list[psutil.Process]]:
        """Return the running processes of this world by what they do."""
        found: dict[str, list[psutil.Process]] = {}
        for process in psutil.process_iter():
            with contextlib.suppress(psutil.Error, OSError):
                if process.environ().get("HIL_CHAOS") == str(self.folder) and process.status() != psutil.STATUS_ZOMBIE:
                    found.setdefault(self._role(process), []).append(process)
        return found

    def _role(self, process: psutil.Process) -> str:
        if process.pid == self.robot.pid:
            return "robot"
        if process.pid == self.service.pid:
            return "service"
        words = process.cmdline()
        for module, role in _ROLES.items():
            if module in words:
                return role
        if (self.viewer is not None and process.pid == self.viewer.pid) or "rerun" in process.name():
            return "viewer"
        return "other"

    def end(self) -> list[str]:
        """End everything in order, as a user does. Return the errors, and the leftovers."""
        trouble = []
        self.kill_viewer()
        for name, process in (("service", self.service), ("robot", self.robot)):
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
            try:
                code = process.wait(WAIT_S)
            except subprocess.TimeoutExpired:
                trouble.append(f"the {name} did not end within {WAIT_S:g} s of SIGTERM")
                process.kill()
                code = process.wait()
            if name == "service" and code != 0:
                trouble.append(f"the service ended with exit code {code}")
        if self.line is not None:
            self.line.close()
        self._log.close()
        if not until(lambda: not self.processes(), 10.0):
            alive = {role: [one.pid for one in those] for role, those in self.processes().items()}
            trouble.append(f"processes were left behind: {alive}")
            self.kill()
        left = sorted(path.name for path in (self.folder / "tmp").iterdir())
        trouble += [f"left behind in the folder for temporary files: {name}" for name in left]
        # A killed service leaves its record of a pseudo-terminal that the next robot did not get again; who looks
        # removes it. Locks of ended processes are files without content, and the audit log stays.
        trouble += [f"a lock is held: {record}" for record in held(state_folder("locks"))]
        left = sorted(str(path) for kind in ("*.token*", "*.json*") for path in (self.folder / "state").rglob(kind))
        return trouble + [f"left behind in the state folder: {name}" for name in left if not name.endswith(".jsonl")]

    def kill_viewer(self) -> None:
        """Kill `hil live`; rerun's own process has to end with it."""
        if self.viewer is not None:
            self.viewer.kill()
            self.viewer.wait()

    def kill(self) -> None:
        """Kill what still runs."""
        for those in self.processes().values():
            for process in those:
                with contextlib.suppress(psutil.Error):
                    process.kill()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()
        if self.line is not None:
            self.line.close()


def until(condition: Callable[[], Any], limit_s: float) -> Any:
    """Return the first true value of a condition, or its last value after ``limit_s``."""
    end_s = time.monotonic() + limit_s
    while not (value := condition()) and time.monotonic() < end_s:
        time.sleep(0.05)
    return value


def _built_clock(folder: Path) -> Path | None:
    """Return the library that moves a process's time of day; None without a compiler."""
    compiler = next(filter(None, map(shutil.which, (os.environ.get("CC", "cc"), "gcc", "clang"))), None)
    if compiler is None or sys.platform != "linux":
        return None
    library = folder / "clock.so"
    source = Path(__file__).with_name("clock.c")
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", library, source], check=True)
    return library


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])
