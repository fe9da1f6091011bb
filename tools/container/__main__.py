"""Runs the steps of the Dockerfile in a folder with Debian's files: ``python -m tools.container``, as root, by hand.

Debian's Python stands for the image python:3.11-slim. The service is then started as the image would start it, its
health is asked for, pytest runs a scenario, and the service is stopped. It needs mmdebstrap (apt install), a network,
some minutes and 3 GB. What only an engine does is not run: images and layers, compose.yaml, limits and capabilities.
"""

import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from tools.debian import make_debian

ROOT = Path(__file__).parents[2]
DOCKERFILE = Path(__file__).with_name("Dockerfile")
_PACKAGES = "python3,python3-pip,python-is-python3,libstdc++6,ca-certificates,passwd"
_HEALTHY_S, _ENDED_S = 60.0, 20.0
_SCENARIO = 'extends = "paper_circle"\nloop.duration_s = 0.5\nexpect = []\n'


def instructions(text: str) -> Iterator[tuple[str, str]]:
    """Yield name and words of each instruction of a Dockerfile; lines that end in a backslash are joined."""
    lines = (line for line in text.splitlines() if not line.lstrip().startswith("#"))
    for line in "\n".join(lines).replace("\\\n", " ").splitlines():
        if line.strip():
            name, _, words = line.strip().partition(" ")
            yield name, words.strip()


@dataclass
class Image:
    """A folder that stands for an image: what its instructions have set so far."""

    root: Path
    user: str = "root"
    folder: str = "/"
    environment: dict[str, str] = field(default_factory=dict)
    command: list[str] = field(default_factory=list)
    health: list[str] = field(default_factory=list)

    def argv(self, command: Sequence[str]) -> list[str]:
        """Return the command line that runs a command in here, as its user and in its folder."""
        inside = f'cd {self.folder} && exec "$@"'
        return ["chroot", f"--userspec={self.user}", str(self.root), "/bin/sh", "-c", inside, "sh", *command]

    def environ(self) -> dict[str, str]:
        """Return the environment of a process in here. Of this machine only what pip and a proxy are set to."""
        kept = {name: value for name, value in os.environ.items() if re.match("PIP_|(https?|no)_proxy", name, re.I)}
        home = "/root" if self.user == "root" else f"/home/{self.user}"
        path = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
        return {**kept, "PIP_BREAK_SYSTEM_PACKAGES": "1", "PATH": path, "HOME": home, **self.environment}

    def run(self, command: Sequence[str]) -> str:
        """Run a command to its end and return its output; a failed command ends the tool."""
        done = subprocess.run(self.argv(command), env=self.environ(), capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise SystemExit(f"{' '.join(command)}: exit code {done.returncode}\n{done.stdout}{done.stderr}")
        return done.stdout


def build(folder: Path) -> Image:
    """Run the Dockerfile's instructions; return the image of the last stage."""
    made: dict[str, Image] = {}
    image: Image | None = None
    for name, words in instructions(DOCKERFILE.read_text(encoding="utf-8")):
        print(name, words, flush=True)
        if name == "FROM":
            stage = words.partition(" AS ")[2] or "last"
            image = made[stage] = Image(_debian(folder / stage))
            continue
        assert image is not None
        match name:
            case "COPY":
                _copy(words, image, made)
            case "RUN":
                image.run(["/bin/sh", "-c", words])
            case "ARG" | "ENV":
                key, _, value = words.partition("=")
                image.environment[key] = value
            case "USER":
                image.user = words
            case "WORKDIR":
                image.folder = words
            case "CMD":
                image.command = json.loads(words)
            case "HEALTHCHECK":
                image.health = json.loads(words.partition("CMD ")[2])
            case "STOPSIGNAL":
                assert words == "SIGTERM"
            case _:
                raise SystemExit(f"{DOCKERFILE}: this tool does not know the instruction {name}")
    assert image is not None
    return image


def _debian(root: Path) -> Path:
    make_debian(root, _PACKAGES)
    shutil.copy("/etc/resolv.conf", root / "etc" / "resolv.conf")
    certificates = "/etc/ssl/certs/ca-certificates.crt"
    shutil.copy(certificates, root / certificates.lstrip("/"))
    for kind in ("dev", "proc"):  # in this process's own mounts, which end with it
        subprocess.run(["mount", "--rbind", f"/{kind}", str(root / kind)], check=True)
    return root


def _copy(words: str, image: Image, made: dict[str, Image]) -> None:
    *options, source, target = words.split()
    there = image.root / target.lstrip("/")
    if options:
        from_stage = made[options[0].removeprefix("--from=")].root
        shutil.copytree(from_stage / source.lstrip("/"), there)
        return
    patterns = DOCKERFILE.with_name("Dockerfile.dockerignore").read_text(encoding="utf-8").split()
    anywhere = shutil.ignore_patterns(*(one.removeprefix("**/") for one in patterns if one.startswith("**/")))

    def ignored(parent: str, names: list[str]) -> set[str]:
        top = set(patterns) & set(names) if Path(parent) == ROOT else set()
        return top | anywhere(parent, names)

    shutil.copytree(ROOT, there, ignore=ignored)


def try_it(image: Image) -> None:
    """Start the service, ask for its health, run a scenario by pytest, and stop the service."""
    assert image.user != "root"
    (image.root / "home" / image.user / "small.hil.toml").write_text(_SCENARIO, encoding="utf-8")
    print(image.run(["hil", "--version"]).strip())
    assert "1 passed" in image.run(["python", "-m", "pytest", "-q", "-p", "no:cacheprovider", "small.hil.toml"])
    command, health, environment = image.argv(image.command), image.argv(image.health), image.environ()
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as service:
        begin_s = time.monotonic()
        while subprocess.run(health, env=environment, capture_output=True, check=False).returncode:
            if service.poll() is not None or time.monotonic() > begin_s + _HEALTHY_S:
                service.kill()
                raise SystemExit(f"the service does not become healthy: {service.communicate()[1]}")
        print(f"healthy after {time.monotonic() - begin_s:.1f} s")
        process = psutil.Process(service.pid)
        users = {one.uids().real for one in (process, *process.children(recursive=True))}
        ports = {
            at.laddr
            for one in (process, *process.children(recursive=True))
            for at in one.net_connections("inet")
            if at.status == psutil.CONN_LISTEN
        }
        service.send_signal(signal.SIGTERM)
        code = service.wait(_ENDED_S)
        print(f"users {users}, listens at {sorted(ports)}, exit code {code} after SIGTERM")
        if 0 in users or code != 0 or {at.ip for at in ports} != {"127.0.0.1"}:
            raise SystemExit("not as it should be: expected no root, 127.0.0.1 alone, and exit code 0")


def main() -> int:
    """Build and try the image in mounts of a process of its own, which end with it; return its exit code."""
    parser = argparse.ArgumentParser(prog="tools.container", description=(__doc__ or "").partition(":")[0])
    parser.add_argument("folder", type=Path, nargs="?", help="given by itself to its inner process")
    folder_of_mounts = parser.parse_args().folder
    if os.geteuid() != 0:
        raise SystemExit("tools.container: chroot needs root")
    if folder_of_mounts is not None:
        image = build(folder_of_mounts)
        usage = subprocess.run(["du", "-smx", str(image.root)], capture_output=True, text=True, check=True).stdout
        print(f"{usage.split()[0]} MB, with Debian's Python and pip")
        try_it(image)
        return 0
    # The folder is removed out here, where nothing is mounted in it: in there it has this machine's /dev.
    with tempfile.TemporaryDirectory(prefix="hil-container-") as folder:
        inside = ["unshare", "--mount", "--propagation", "private", sys.executable, "-m", "tools.container", folder]
        return subprocess.run(inside, cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
