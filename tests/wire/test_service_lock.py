"""The locks of a device and the record of a service: the operating system releases them when their process ends."""

import contextlib
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.addons.service.discovery import Service, announce, running
from hil.core.errors import BadInputError, LinkError
from hil.core.private_files import private_folder
from hil.core.process_lock import LockHeldError, ProcessLock, held
from hil.wire import device_lock
from hil.wire.device_lock import _file_name, _folders, claim_file, device_held
from hil.wire.serial_url import SerialUrl
from hil.wire.url import parse_link
from tests.support import slcan_adapters
from tests.support.examples import share_of_examples
from tests.support.processes import environment, hil, hil_process, own_state

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


NO_MODES = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no modes of files")
# It imports as root, because another user may have no right to read the modules.
STRANGER = """
import os, sys
import hil.wire.serial_port
from pathlib import Path
from hil.core.errors import HilError
from hil.wire.device_lock import device_held
from hil.wire.url import parse_link
link, lock = sys.argv[1:]
for kind in ("serial:", "can:slcan/"):
    try:
        with device_held(parse_link("serial:/nowhere"), "hil run"):
            parse_link(kind + "/nowhere").open_host()
    except HilError:
        pass
os.environ.pop("XDG_STATE_HOME")
os.environ["HOME"] = "/nonexistent"
os.setgroups([])
os.setgid(65534)
os.setuid(65534)
for does in (os.unlink, lambda path: open(path), lambda path: os.rename(path, "/tmp/mine")):
    try:
        does(lock)
    except PermissionError:
        print("forbidden")
try:
    with device_held(parse_link(link), "hil run"):
        parse_link(link).open_host().close()
    print("open")
except HilError as error:
    print(error)
"""


@NO_MODES
@pytest.mark.parametrize("kind", ["serial:", "can:slcan/"])
def test_another_user_is_kept_from_an_open_device_and_from_its_locks(kind: str, tmp_path: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("only root can be two users")
    if not all(folder.stat().st_mode & stat.S_IXOTH for folder in Path(device_lock.__file__).parents):
        pytest.skip("another user cannot read this checkout: move it out of the folder that only its owner may enter")
    bus = slcan_adapters.SlcanBus(1)
    Path(bus.ports[0]).chmod(0o666)
    link = f"{kind}{bus.ports[0]}"

    def stranger_says() -> list[str]:
        command = [sys.executable, "-c", STRANGER, link, str(lock)]
        done = subprocess.run(command, capture_output=True, text=True, env=environment(), check=False, cwd="/")
        assert done.returncode == 0, done.stderr
        return done.stdout.splitlines()

    try:
        with own_state(tmp_path):
            with device_held(parse_link(link), "hil run"), contextlib.closing(parse_link(link).open_host()):
                (lock,) = (tmp_path / "mecanum-hil" / "locks").glob("*.lock")
                *deeds, said = stranger_says()
                assert deeds == ["forbidden"] * 3
                assert "is busy: another program holds it; close that program" in said
            assert stranger_says()[-1] == "open"
    finally:
        bus.close()


CLAIMANT = (
    "import sys\nfrom hil.wire.device_lock import claim_file\n"
    "give_back = claim_file('/sys/class/net/lo/type', 'it')\nprint('held', flush=True)\nsys.stdin.read()\n"
)


@pytest.mark.skipif(not Path("/sys/class/net/lo/type").exists(), reason="needs the network interfaces of Linux")
def test_a_can_interface_is_one_process_s_whoever_runs_it() -> None:
    """Loopback is no CAN bus: the holder of its lock learns that when it opens the bus."""
    command = [sys.executable, "-c", CLAIMANT]
    holder = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment())
    assert holder.stdout is not None
    assert holder.stdout.readline() == "held\n"
    refused = hil("params", "can:socketcan/lo")
    assert refused.returncode == 3
    assert "CAN interface 'socketcan', channel 'lo' is busy: another program holds it" in refused.stderr
    holder.kill()
    holder.communicate()
    assert "is busy" not in hil("params", "can:socketcan/lo").stderr
    first = claim_file("/sys/class/net/lo/type", "it")
    claim_file("/sys/class/net/lo/type", "it")()  # a second link of one process, such as a fault's babbling node
    assert hil_process("params", "can:socketcan/lo").stderr == refused.stderr
    first()


@NO_MODES
def test_what_a_lock_or_a_service_writes_is_for_its_user_alone(port: Path, tmp_path: Path) -> None:
    old = os.umask(0)
    try:
        with own_state(tmp_path):
            claim = announce(SERVICE)
            with device_held(SerialUrl(str(port)), "hil run"):
                for folder in (tmp_path / "mecanum-hil" / name for name in ("locks", "services")):
                    assert {stat.S_IMODE(path.stat().st_mode) for path in folder.iterdir()} == {0o600}
                    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
            claim.release()
    finally:
        os.umask(old)


SERVICE = Service("http://127.0.0.1:8770", 1, "paper_circle", "serial:/dev/ttyACM0", "/nowhere")


def test_a_service_is_found_while_its_process_lives(tmp_path: Path) -> None:
    script = (
        "import time\nfrom hil.addons.service.discovery import Service, announce\n"
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


@NO_MODES
def test_a_folder_that_is_not_this_user_s_alone_is_not_used_for_locks(
    port: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    private, link, open_to_all, last = (tmp_path / name for name in ("private", "link", "open", "last"))
    private.mkdir(mode=0o700)
    link.symlink_to(private)
    open_to_all.mkdir()
    open_to_all.chmod(0o777)
    folders = [link, open_to_all]
    if os.geteuid() == 0:
        folders.append(tmp_path / "of another user")
        folders[-1].mkdir(mode=0o700)
        os.chown(folders[-1], 65534, 65534)
    for folder in folders:
        with pytest.raises(OSError, match="no folder that this user alone may write to"):
            private_folder(folder)
    monkeypatch.setattr("hil.wire.device_lock._folders", lambda: iter([*folders, last]))
    with device_held(SerialUrl(str(port)), "hil run"):
        assert len(list(last.iterdir())) == 2
    monkeypatch.setattr("hil.wire.device_lock._folders", lambda: iter(folders[:2]))
    with pytest.raises(LinkError) as refused, device_held(SerialUrl(str(port)), "hil run"):
        pass
    why = "it is no folder that this user alone may write to"
    assert str(refused.value) == (
        f"link 'serial:{port}': the lock that keeps other processes from the device cannot be taken ({link}: {why}; "
        f"{open_to_all}: {why}); make one of these folders yours alone, with mode 0700"
    )
    monkeypatch.setattr("hil.wire.device_lock._folders", lambda: iter(folders))
    with pytest.raises(LinkError, match=rf"{link}: it is no folder .* with mode 0700"):
        device_held(SerialUrl(str(port)), "hil run").__enter__()
    assert not any(list(folder.iterdir()) for folder in folders)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such folders")
def test_a_user_without_a_home_has_a_folder_for_locks_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_STATE_HOME", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    at_home, *others = _folders()
    assert at_home.is_relative_to(tmp_path)
    assert all(str(os.getuid()) in str(folder) for folder in others)


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "mecanum-hil").touch()
    with own_state(tmp_path), pytest.raises(BadInputError, match=r"services: it cannot be used"):
        announce(SERVICE)
