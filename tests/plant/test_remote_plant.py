"""A plant in a process of its own: the same plant bit for bit, and whatever its FMU does, this process goes on."""

import os
import random
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol.built import FLAGS
from hil.core.errors import BadInputError, DeviceError
from hil.core.subprocesses import MEMORY_IS_KNOWN
from hil.core.types import Wheels
from hil.plant import shim
from hil.plant.built import PLANT_PORT
from hil.plant.fmu import FmuPlant
from hil.plant.mapping import Row, SignalMap
from hil.plant.remote import RemotePlant
from tests.support.flawed_fmu import build_flawed
from tests.support.foreign_fmu import foreign_fmu, foreign_map
from tests.support.plant_testbed import FMU
from tests.support.processes import ROOT, environment, is_running, wait_for
from tools.build.compiler import compiler

START = {"start_heading_rad": 0.3, "start_vx_m_s": 0.5, "counts_per_revolution": 4096.0}
TORQUE = Wheels(1.0, 0.5, 1.0, 0.25)
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="signal 40 is a real-time signal on Linux alone")


@pytest.fixture(scope="module")
def flawed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_flawed(tmp_path_factory.mktemp("flawed"))


@pytest.fixture
def scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of temporary files, empty."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return tmp_path


def exchanges(plant: FmuPlant | RemotePlant, ticks: int) -> Iterator[tuple[Any, ...]]:
    """Drive the plant port as the firmware does, by random torques; yield all that comes back."""
    ffi, _ = shim.load()
    exchange = ffi.cast("wheel_plant_exchange", plant.exchange_address)
    context = ffi.cast("void *", plant.context_address)
    drive, sense = ffi.new("wheel_drive *"), ffi.new("wheel_sense *")
    rng = random.Random(11)
    assert exchange(context, ffi.NULL, sense) == 0
    for tick in range(ticks):
        drive.tick, drive.enabled, drive.torque_n_m = tick, 1, [rng.uniform(-2, 2) for _ in range(4)]
        assert exchange(context, drive, sense) == 0
        yield bytes(ffi.buffer(sense)), plant.truth(), plant.wheel_speeds()


def test_the_child_gives_the_bits_of_the_plant_in_this_process() -> None:
    wiring = ((2, 0, 3, 1), (1, -1, -1, 1))
    with FmuPlant(FMU, START) as here, RemotePlant(FMU, START) as there:
        here.wire(*wiring)
        there.wire(*wiring)
        assert there.truth() == here.truth()
        assert list(exchanges(there, 500)) == list(exchanges(here, 500))
        here.step(TORQUE, 20)
        there.step(TORQUE, 20)
        assert there.truth() == here.truth()
        assert there.truth().time_ns == 520_000_000
        there.reset()
        here.reset()
        assert list(exchanges(there, 50)) == list(exchanges(here, 50)), "after a reset, with the wiring kept"


@pytest.mark.parametrize("version", [2, 3])
def test_start_and_map_reach_the_child(tmp_path: Path, version: int) -> None:
    fmu = foreign_fmu(tmp_path, version)
    arguments = (fmu, {"gear": "geared", "reversed": True}, foreign_map(version))
    with FmuPlant(*arguments) as here, RemotePlant(*arguments) as there:
        assert list(exchanges(there, 100)) == list(exchanges(here, 100))
        assert there.truth().time_ns == 100_000_000
        assert max(there.wheel_speeds()) > 0.1


@pytest.mark.parametrize(
    ("flaw", "words"),
    [
        ("segfault", r"was ended by SIGSEGV \(.*\); its last words: 'the last words of a crash'"),
        ("abort", r"was ended by SIGABRT \(.*\)"),
        pytest.param("fork", r"its process was ended by SIGABRT \(.*\)", marks=LINUX),
        pytest.param("write", r"it wrote into the pipe of its process: '(\\x1b){200}'", marks=LINUX),
        ("exit", "its process exited with code 0"),
        ("hang", r"it gave no answer within 0\.5 s and was ended"),
        ("error", r"doStep: .*-0\.001"),
        ("nan", r"pose\.x_m is not a number; expected a finite number"),
    ],
)
def test_what_the_fmu_does_is_said_and_undone_by_a_reset(
    flawed: Path, monkeypatch: pytest.MonkeyPatch, flaw: str, words: str
) -> None:
    monkeypatch.setenv("FLAW", f"{flaw} 0.02")
    with RemotePlant(flawed, {}, timeout_s=0.5) as plant:
        start = plant.truth()
        plant.step(TORQUE, 20)
        good = plant.truth()
        with pytest.raises(DeviceError, match=f"^the plant stopped at 0.02 s: .*{words}") as caught:
            plant.step(TORQUE)
        assert "\n" not in str(caught.value)
        assert (plant.truth(), start.time_ns) == (good, 0)
        assert plant.message in str(caught.value)
        with pytest.raises(DeviceError, match=words):
            plant.step(TORQUE)
        plant.reset()
        assert (plant.truth(), plant.message) == (start, "")
        plant.step(TORQUE, 20)
        assert plant.truth() == good


@pytest.mark.parametrize(
    ("flaw", "words"),
    [
        ("segfault", "SIGSEGV .*; its last words: 'the last words of a crash'"),
        ("exit", "exited with code 0"),
        ("hang", r"gave no answer within 1 s and was ended"),
    ],
)
def test_an_fmu_that_ends_its_process_while_it_is_opened(
    flawed: Path, scratch: Path, monkeypatch: pytest.MonkeyPatch, flaw: str, words: str
) -> None:
    monkeypatch.setenv("FLAW", f"{flaw} -1")
    with pytest.raises(DeviceError, match=rf"^the plant flawed\.fmu could not be opened: .*{words}"):
        RemotePlant(flawed, {}, timeout_s=0.1)
    assert list(scratch.iterdir()) == []


def test_an_fmu_that_makes_no_instance_and_says_nothing_may_be_of_two_builds(
    flawed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FLAW", "no_instance -1")
    with pytest.raises(BadInputError, match=r"it made no instance: it did not say why$"):
        RemotePlant(flawed, {})


@pytest.mark.skipif(not MEMORY_IS_KNOWN, reason="this system does not tell how much memory a process takes")
def test_an_fmu_that_takes_more_memory_than_it_may_is_ended(flawed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """50 MB a tick; within the tenth of a second between two looks it may take a little more than its limit."""
    monkeypatch.setenv("FLAW", "hog 0.02")
    words = r"it took \d+ MB of memory, more than the limit of 300 MB \(plant\.memory_limit_mb\), and was ended"
    with RemotePlant(flawed, {}, memory_limit_mb=300.0) as plant:
        with pytest.raises(DeviceError, match=rf"^the plant stopped at 0\.\d+ s: {words}$"):
            plant.step(TORQUE, 200)
        plant.reset()
        assert plant.truth().time_ns == 0


def test_where_memory_is_not_told_that_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.plant.remote.MEMORY_IS_KNOWN", False)
    with RemotePlant(FMU, {}) as plant:
        assert plant.output.new_lines() == ["nothing yet; its limit of 2000 MB is not watched on this system"]


@pytest.mark.parametrize("kind", [FmuPlant, RemotePlant])
def test_what_an_fmu_says_is_one_line_that_steers_no_terminal(
    tmp_path: Path, kind: type[FmuPlant | RemotePlant]
) -> None:
    rude = foreign_fmu(tmp_path, 2, guid="\x9b31mred\nnext\u2028")
    with pytest.raises(BadInputError, match="it made no instance: wrong GUID 31mred next") as caught:
        kind(rude, {}, mapping=foreign_map(2))
    assert str(caught.value).isprintable()
    assert "last words" not in str(caught.value), "it has said that already"


def test_what_an_fmu_prints_disturbs_nothing(flawed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """2 MB within 200 ticks, which no pipe holds."""
    monkeypatch.setenv("FLAW", "print 0")
    with FmuPlant(FMU, START) as here, RemotePlant(flawed, START) as there:
        assert list(exchanges(there, 200)) == list(exchanges(here, 200))


@pytest.mark.skipif(sys.platform == "win32", reason="signals need a POSIX system")
@pytest.mark.parametrize(
    ("number", "words"),
    [
        (signal.SIGKILL, r"its process was ended by SIGKILL"),
        (signal.SIGTERM, r"its process was ended by SIGTERM"),
        pytest.param(40, r"its process was ended by signal 40 \(", marks=LINUX),
        (signal.SIGSTOP, r"it gave no answer within 0\.5 s and was ended"),
    ],
)
def test_a_child_that_somebody_ends_is_a_failure(number: int, words: str) -> None:
    with RemotePlant(FMU, {}, timeout_s=0.5) as plant:
        plant.step(TORQUE, 5)
        os.kill(plant.pid, number)
        with pytest.raises(DeviceError, match=rf"stopped at 0\.005 s: {words}"):
            plant.step(TORQUE, 100_000)


def test_a_slow_fmu_is_no_hung_one(flawed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Printing, these ticks take longer together than the limit for one."""
    monkeypatch.setenv("FLAW", "print 0")
    with RemotePlant(flawed, {}, timeout_s=0.5) as plant:
        plant.step(TORQUE, 1000)
        assert plant.truth().time_ns == 1_000_000_000


@pytest.mark.skipif(sys.platform == "win32", reason="signals need a POSIX system")
@pytest.mark.parametrize("flaw", ["none 0", "hang 0"])
def test_a_killed_parent_leaves_no_child_and_no_files(flawed: Path, tmp_path: Path, flaw: str) -> None:
    """An idle child sees the end of its pipe; a hanging child sees that nobody reads its output."""
    code = (
        "import sys; from pathlib import Path; from hil.core.types import Wheels\n"
        "from hil.plant.remote import RemotePlant\n"
        f"plant = RemotePlant(Path({str(flawed)!r}), {{}}, timeout_s=1000)\n"
        "print(plant.pid, flush=True)\n"
        + ("plant.step(Wheels(1, 1, 1, 1))" if flaw != "none 0" else "sys.stdin.read()")
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", code],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=environment() | {"FLAW": flaw, "TMPDIR": str(tmp_path)},
        cwd=ROOT,
    )
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
    assert is_running(pid)
    assert list(tmp_path.iterdir()) != []
    parent.kill()
    parent.wait()
    wait_for(lambda: not is_running(pid))
    parent.communicate()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="process groups need a POSIX system")
def test_the_terminals_signals_do_not_reach_the_child() -> None:
    with RemotePlant(FMU, {}) as plant:
        assert os.getpgid(plant.pid) != os.getpgid(0)
        assert os.getsid(plant.pid) != os.getsid(0)


def test_where_no_process_can_be_started_that_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/no/such/python")
    with pytest.raises(DeviceError, match=r"no process can be started for the plant \(.*No such file.*\); end others"):
        RemotePlant(FMU, {})


def test_plants_are_independent(flawed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FLAW", "segfault 0.01")
    with RemotePlant(flawed, {}) as flawed_plant, RemotePlant(FMU, {"mass_kg": 5.0}) as sound:
        assert flawed_plant.pid != sound.pid
        sound.step(TORQUE, 10)
        before = sound.truth()
        with pytest.raises(DeviceError, match="SIGSEGV"):
            flawed_plant.step(TORQUE, 100)
        assert sound.truth() == before
        sound.step(TORQUE, 10)
        assert sound.truth().time_ns == 20_000_000


@pytest.mark.parametrize(
    ("start", "rows"),
    [
        ({"mas_kg": 24.0}, {}),
        ({"mass_kg": -1.0}, {}),
        ({"contact": "slipp"}, {}),
        ({}, {"wheel.fl.torque_n_m": Row("tau_1"), "pose.x_m": Row("pose.x")}),
    ],
)
def test_bad_input_is_refused_in_the_words_of_the_plant_in_this_process(
    start: dict[str, float | str], rows: dict[str, Row], scratch: Path
) -> None:
    messages = []
    for kind in (FmuPlant, RemotePlant):
        with pytest.raises(BadInputError) as caught:
            kind(FMU, start, mapping=SignalMap(rows))
        messages.append(str(caught.value))
    assert messages[0] == messages[1]
    assert list(scratch.iterdir()) == []


def test_a_wrong_wiring_is_refused_and_changes_nothing() -> None:
    with RemotePlant(FMU, {}) as plant:
        with pytest.raises(BadInputError, match="expected each of 0 to 3 once"):
            plant.wire((0, 1, 2, 2), (1, 1, 1, 1))
        plant.step(TORQUE, 10)
        assert plant.message == ""


def test_closing_ends_the_child_and_leaves_nothing_behind(scratch: Path) -> None:
    threads = threading.active_count()
    plant = RemotePlant(FMU, {})
    assert list(scratch.iterdir()) != []
    plant.close()
    plant.close()
    assert list(scratch.iterdir()) == []
    wait_for(lambda: threading.active_count() == threads)
    with pytest.raises(DeviceError, match="the FMU is closed"):
        plant.step(TORQUE)
    with pytest.raises(DeviceError, match="the plant is closed"):
        plant.reset()
    with pytest.raises(ProcessLookupError):
        os.kill(plant.pid, 0)


@pytest.mark.skipif(sys.platform == "win32", reason="the driver forks")
def test_the_pipes_pass_the_sanitizers_with_pieces_signals_and_a_peer_that_leaves(tmp_path: Path) -> None:
    program = tmp_path / "remote_driver"
    sanitize = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g"]
    sources = [ROOT / "tests" / "plant" / "remote_driver.c", ROOT / "hil" / "plant" / "remote.c"]
    include = [f"-I{ROOT / 'hil' / 'plant'}", f"-I{PLANT_PORT.parent}"]
    command = [*compiler(), *FLAGS, *sanitize, *include, *map(str, sources), "-o", str(program)]
    assert subprocess.run(command, capture_output=True, text=True, check=False).stderr == ""
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
