"""A service whose recording cannot be written says so at once, and does the configured action."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import httpx
import psutil
import pytest

from hil.addons.service.messages import Action
from hil.core.errors import DeviceError
from hil.core.tokens import token_file
from hil.record.reader import read
from tests.addons.service.test_serve import Serving, serving
from tests.support.processes import HIL, wait_for

pytestmark = [pytest.mark.alone, pytest.mark.usefixtures("state_home")]
LIMIT = ("--set", "service.recordings_gb=0.01")
FULL = "GB, and 0.01 GB are allowed; remove some, or allow more"


def fill(folder: Path, name: str = "others.mcap", written_s: float | None = None, size_bytes: int = 20_000_000) -> Path:
    """Let the recordings in the service's folder take more than it may hold."""
    path = folder / "runs" / name
    path.parent.mkdir(exist_ok=True)
    with path.open("wb") as file:
        file.truncate(size_bytes)
    if written_s is not None:
        os.utime(path, (written_s, written_s))
    return path


def in_trouble(service: Serving) -> dict[str, Any]:
    status: dict[str, Any] = wait_for(lambda: status if (status := service.status()).get("recording_trouble") else None)
    return status


def metric(service: Serving, name: str) -> float:
    """Return a metric, from the service's own page for Prometheus."""
    url = next(line["url"] for line in service.lines if line["event"] == "API listens")
    token = token_file("services", int(url.rpartition(":")[2])).read_text().strip()
    headers = {"Authorization": f"Bearer {token}"}
    text = httpx.get(f"{url}/metrics", headers=headers, trust_env=False).text
    return float(next(line.split()[1] for line in text.splitlines() if line.startswith(f"{name} ")))


def test_a_recording_for_which_there_is_no_room_ends_and_the_robot_drives_on(tmp_path: Path) -> None:
    with serving(tmp_path, *LIMIT, "--record", "run.mcap") as service:
        service.drive()
        other = fill(tmp_path)
        status = in_trouble(service)
        assert status["recording_trouble"].endswith(FULL)
        assert (status["phase"], status["task"]) == ("active", "track")
        assert service.line("recording cannot be written")["why"].endswith(FULL)
        assert service.until(recording=None)["rows_lost"] == 0
        assert service.line("recording finished")["lost"] == 0
        other.unlink()
        service.client.order(Action.RECORD, {"name": "next.mcap"})
        assert service.until(recording="runs/next.mcap")["recording_trouble"] is None
        assert service.status()["phase"] == "active"
    assert len(read(tmp_path / "runs/run.mcap").signals["loop.t_s"])


def test_a_robot_that_must_be_recorded_stops_when_it_cannot_be(tmp_path: Path) -> None:
    with serving(tmp_path, *LIMIT, "--set", "service.when_full=stop_robot", "--record", "run.mcap") as service:
        service.drive()
        other = fill(tmp_path)
        status = service.until(phase="disarmed")
        assert status["why"].startswith("its recording cannot be written: the recordings in")
        with pytest.raises(DeviceError, match=r"service\.when_full is stop_robot; make room, or end the recording"):
            service.client.order(Action.ARM)
        other.unlink()
        service.until(recording_trouble=None)
        service.line("recording is written again")
        service.client.order(Action.ARM)
        service.until(phase="active")


def test_a_recorder_that_is_killed_is_told_once_and_the_status_names_the_part_that_is_written_now(
    tmp_path: Path,
) -> None:
    with serving(tmp_path, "--record", "run.mcap") as service:
        service.until(recording="runs/run.mcap", phase="disarmed")
        (recorder,) = (
            one for one in psutil.Process(service.process.pid).children() if "hil.record.recorder" in one.cmdline()
        )
        recorder.kill()
        line = service.line("recorder ended")
        assert (line["level"], line["path"], line["why"]) == ("warning", "runs/run.mcap", "exit status -9")
        status = service.until(recording="runs/run-2.mcap")
        assert (status["recording_trouble"], status["rows_lost"]) == (None, 0)
        service.process.send_signal(signal.SIGTERM)
        assert service.exit_code() == 0
        service.line("service ends")
    assert [line["event"] for line in service.lines].count("recorder ended") == 1
    both = read(tmp_path / "runs/run.mcap")
    assert "recorder ended: exit status -9" in [event.text for event in both.events]


def use_up(filler: Path) -> None:
    """Take all room of a disk. Raises OSError when there is no more."""
    with filler.open("wb", buffering=0) as file:
        while True:
            file.write(bytes(1 << 16))


@pytest.mark.skipif(sys.platform != "linux", reason="mounts a disk in a namespace, as Linux can")
def test_a_full_disk_is_told_while_the_service_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk is one of the service's own, and goes away with it."""
    runs = tmp_path / "runs"
    runs.mkdir()
    own = ["unshare", "--mount"] if os.geteuid() == 0 else ["unshare", "--mount", "--map-root-user"]
    with_disk = [*own, "sh", "-c", 'mount -t tmpfs -o size=8m tmpfs "$1" || exit 77; shift; exec "$@"', "sh", str(runs)]
    if subprocess.run([*with_disk, "true"], check=False).returncode:
        pytest.skip("no disk may be mounted here")
    monkeypatch.setattr("tests.addons.service.test_serve.HIL", [*with_disk, *HIL])
    with serving(tmp_path, "--record", "run.mcap") as service:
        disk = Path(f"/proc/{service.process.pid}/root{runs}")
        service.until(recording="runs/run.mcap", rows_lost=0, recording_trouble=None)
        with pytest.raises(OSError, match="No space left"):
            use_up(disk / "filler")
        why = in_trouble(service)["recording_trouble"]
        assert why == "the disk is full (No space left on device)"
        assert metric(service, "hil_recording_trouble") == 1.0
        assert service.line("recording cannot be written")["why"] == why
        lost = service.line("recording is not complete")["lost"]
        service.until(recording=None, rows_lost=lost)
        assert metric(service, "hil_rows_lost_total") == lost > 0
        (disk / "filler").unlink()
        service.client.order(Action.RECORD, {"name": "next.mcap"})
        assert service.until(recording="runs/next.mcap")["recording_trouble"] is None
