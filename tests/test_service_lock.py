"""The lock of a device and the record of a service: the operating system releases both when their process ends."""

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.errors import BadInputError, LinkError
from hil.core.process_lock import LockHeldError, ProcessLock, held
from hil.service.discovery import Service, announce, running
from hil.wire.device_lock import _file_name, _folder, device_held
from hil.wire.url import SerialUrl, parse_link
from tests.examples import share_of_examples
from tests.processes import environment
from tests.service_testbed import own_state

HOLDER = (
    "import sys, time\nfrom hil.wire.url import parse_link\nfrom hil.wire.device_lock import device_held\n"
    "with device_held(parse_link(sys.argv[1]), sys.argv[2]):\n    print('held', flush=True)\n    time.sleep(600)\n"
)


@pytest.fixture
def port(tmp_path: Path) -> Path:
    """A name of this test's own, that no other process on this machine uses."""
    path = tmp_path / "ttyACM0"
    path.touch()
    return path


def test_a_device_is_held_by_one_process_under_whatever_name_until_that_dies(port: Path, tmp_path: Path) -> None:
    by_id = tmp_path / "usb-board"
    by_id.symlink_to(port)
    command = [sys.executable, "-c", HOLDER, f"serial:{by_id}?baud=115200", "hil serve my_robot"]
    holder = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment())
    assert holder.stdout is not None
    assert holder.stdout.readline() == "held\n"
    other = subprocess.run(
        [sys.executable, "-c", HOLDER, f"can:slcan/{port}@115200", "hil run"],
        capture_output=True,
        text=True,
        env=environment(),
        check=False,
    )
    said = other.stderr.strip().splitlines()[-1]
    assert f"'hil serve my_robot' (process {holder.pid}) has had the device since" in said
    assert "drive it with 'hil ctl'" in said
    holder.kill()
    holder.communicate()
    with device_held(SerialUrl(str(port)), "hil run"):
        pass


def test_a_device_that_was_given_back_is_free_and_one_that_is_held_is_not(port: Path) -> None:
    url = SerialUrl(str(port))
    for _ in range(2):
        with device_held(url, "hil run"), pytest.raises(LinkError, match=f"process {os.getpid()}"):
            device_held(url, "hil params").__enter__()


@pytest.mark.parametrize("link", ["memory:", "serial:pty", "serial:pty?symlink=/tmp/robot", "can:virtual/bus"])
def test_a_link_that_makes_its_own_robot_is_nobodys(link: str) -> None:
    url = parse_link(link)
    assert url.device_name() is None
    with device_held(url, "hil run"), device_held(url, "hil run"):
        pass


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("serial:/dev/ttyACM7", "serial:/dev/../dev/ttyACM7?baud=115200"),
        ("serial:/dev/ttyACM7", "can:slcan//dev/ttyACM7@115200"),
        ("can:socketcan/can0", "can:socketcan/can0?bitrate=500000&fd=1"),
    ],
)
def test_options_make_no_other_device(one: str, other: str) -> None:
    assert parse_link(one).device_name() == parse_link(other).device_name()
    assert parse_link(one).device_name() != parse_link("can:socketcan/can1").device_name()


@share_of_examples(0.3)
@given(st.text(min_size=1, max_size=100), st.text(min_size=1, max_size=100))
def test_two_ports_have_one_lock_only_when_they_are_one(one: str, other: str) -> None:
    assert (_file_name(one) == _file_name(other)) == (one == other)
    assert "/" not in _file_name(one)
    assert len(_file_name(one)) < 100


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no modes of files")
def test_the_lock_of_a_device_is_for_all_users_and_the_record_of_a_service_for_one(port: Path, tmp_path: Path) -> None:
    old = os.umask(0o077)
    try:
        with device_held(SerialUrl(str(port)), "hil run"):
            mine = [path for path in _folder().iterdir() if port.parent.name in path.name]
            assert {stat.S_IMODE(path.stat().st_mode) for path in mine} == {0o666}
            assert stat.S_IMODE(_folder().stat().st_mode) == 0o777
        os.umask(0)
        with own_state(tmp_path):
            claim = announce(SERVICE)
            folder = tmp_path / "mecanum-hil" / "services"
            assert {stat.S_IMODE(path.stat().st_mode) for path in folder.iterdir()} == {0o600}
            assert stat.S_IMODE(folder.stat().st_mode) == 0o700
            claim.release()
    finally:
        os.umask(old)


SERVICE = Service("http://127.0.0.1:8770", 1, "paper_circle", "serial:/dev/ttyACM0", "/nowhere")


def test_a_service_is_found_while_its_process_lives(tmp_path: Path) -> None:
    script = (
        "import time\nfrom hil.service.discovery import Service, announce\n"
        f"claim = announce({SERVICE!r})\nprint('there', flush=True)\ntime.sleep(600)\n"
    )
    with own_state(tmp_path):
        assert running() == []
        holder = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True, env=environment())
        assert holder.stdout is not None
        assert holder.stdout.readline() == "there\n"
        assert running() == [SERVICE]
        assert running() == [SERVICE], "to look is not to take"
        with pytest.raises(BadInputError, match="port 8770: process 1 serves there"):
            announce(SERVICE)
        holder.kill()
        holder.communicate()
        assert running() == []
        claim = announce(SERVICE)
        assert running() == [SERVICE]
        claim.release()
        claim.release()
        assert running() == []


def test_a_claim_whose_record_is_unreadable_is_held_all_the_same(tmp_path: Path) -> None:
    claim = ProcessLock(tmp_path, "one", {"pid": 1})
    (tmp_path / "one.json").write_text("{")
    with pytest.raises(LockHeldError) as taken:
        ProcessLock(tmp_path, "one", {"pid": 2})
    assert taken.value.holder == {}
    assert list(held(tmp_path)) == []
    claim.release()
    ProcessLock(tmp_path, "one", {"pid": 2}).release()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no modes of files")
def test_a_link_in_place_of_the_folder_for_locks_is_refused_and_not_followed(
    port: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    private, link = tmp_path / "private", tmp_path / "locks"
    private.mkdir(mode=0o700)
    link.symlink_to(private)
    monkeypatch.setattr("hil.wire.device_lock._folder", lambda: link)
    with pytest.raises(LinkError, match=f"make sure that {link} can be written"):
        device_held(SerialUrl(str(port)), "hil run").__enter__()
    assert stat.S_IMODE(private.stat().st_mode) == 0o700
    assert list(private.iterdir()) == []


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "mecanum-hil").touch()
    with own_state(tmp_path), pytest.raises(BadInputError, match=r"services: it cannot be made"):
        announce(SERVICE)
