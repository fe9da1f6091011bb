"""``hil doctor``: on this machine as it is, and on trees as other machines have them."""

import contextlib
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from packaging.requirements import Requirement

from firmware_protocol.built import WHEEL_HOST
from hil.addons.doctor import checks, doctor_command
from hil.addons.doctor.doctor_command import lines as lines_of
from hil.core.clock import TICK_NS
from hil.core.errors import BadInputError
from hil.core.findings import Finding, Level, note, ok, problem
from hil.plant import archive
from hil.runtime import realtime
from hil.scenario.tables import RealtimeTable
from tests.support.processes import hil

NEWER_PYTHON = "install a newer Python, and this package into it"
linux = pytest.mark.skipif(sys.platform != "linux", reason="the trees are Linux's")


def _verdicts(findings: list[Finding]) -> dict[str, Level]:
    return {finding.subject: finding.verdict for finding in findings}


def _tree(root: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        file = root / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    return root


def test_this_machine_is_examined_and_all_but_what_is_ok_has_a_remedy(tmp_path: Path) -> None:
    done = hil("doctor", "--json", "--folder", tmp_path / "not" / "yet")
    findings = json.loads(done.stdout)
    assert done.returncode == any(found["verdict"] == "problem" for found in findings), done.stderr
    subjects = {found["subject"] for found in findings}
    assert subjects >= {"Python", "packages", "native library", "plant", "lateness", "disk", "viewer"}
    assert all(bool(found["remedy"]) is (found["verdict"] != "ok") for found in findings)
    assert not (tmp_path / "not").exists()


FINDINGS = [ok("disk", "large"), note("frequency", "low", "raise it")]


@pytest.mark.parametrize(("more", "code"), [([], 0), ([problem("plant", "not built", "build it")], 1)])
def test_the_command_prints_findings_and_fails_at_a_problem_alone(
    monkeypatch: pytest.MonkeyPatch, more: list[Finding], code: int
) -> None:
    looked_at: list[Path] = []

    def found(folder: Path) -> list[Finding]:
        looked_at.append(folder)
        return [*FINDINGS, *more]

    monkeypatch.setattr(doctor_command, "_of_machine", found)
    done = hil("doctor")
    assert (done.returncode, done.stdout.splitlines()) == (code, list(lines_of([*FINDINGS, *more])))
    done = hil("doctor", "--json", "--folder", "kept")
    assert (done.returncode, [Finding(**one) for one in json.loads(done.stdout)]) == (code, [*FINDINGS, *more])
    assert looked_at == [Path("runs"), Path("kept")]


@pytest.mark.parametrize("viewers", [[], [ok("viewer", "there")]])
def test_every_check_is_made_and_those_of_add_ons_that_are_there(
    monkeypatch: pytest.MonkeyPatch, viewers: list[Finding]
) -> None:
    names = [name for name in vars(checks) if name.startswith("check_")]
    for name in names:
        monkeypatch.setattr(checks, name, lambda *given, name=name: iter([ok(name, str(*given))]))
    ours = {"viewer": SimpleNamespace(load=lambda: lambda: viewers)} if viewers else {}
    monkeypatch.setattr(doctor_command, "Extensions", lambda group: {"hil.checks": SimpleNamespace(ours=ours)}[group])
    found = doctor_command._of_machine(Path("kept"))
    assert sorted(one.subject for one in found) == sorted([*names, *(one.subject for one in viewers)])
    assert {one.subject: one.sentence for one in found}["check_disk"] == "kept"


def test_findings_are_printed_with_what_to_do_below(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    lines = list(lines_of(list(checks.check_native())))
    (place,) = [number for number, line in enumerate(lines) if "no-such-compiler" in line]
    assert lines[place].startswith("note     C compiler")
    assert lines[place + 1].strip().startswith("-> sudo apt install gcc")


@linux
def test_a_machine_that_was_set_up_for_real_time_is_ok(tmp_path: Path) -> None:
    cpus = "sys/devices/system/cpu"
    files = {
        "sys/kernel/realtime": "1\n",
        f"{cpus}/cpu0/cpufreq/scaling_governor": "performance\n",
        f"{cpus}/isolated": "2-3\n",
    }
    found = list(checks.check_kernel(_tree(tmp_path, files)))
    assert set(_verdicts(found).values()) == {Level.OK}
    assert [one.sentence.partition(";")[0] for one in found[1:]] == ["governor performance", "isolated: 2, 3"]


@linux
def test_a_machine_that_was_not_gets_the_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 8)
    monkeypatch.setattr("platform.version", lambda: "#1 SMP PREEMPT_DYNAMIC")
    monkeypatch.setattr("platform.release", lambda: "6.1.0")
    governors = {f"sys/devices/system/cpu/cpu{n}/cpufreq/scaling_governor": "powersave\n" for n in range(8)}
    found = list(checks.check_kernel(_tree(tmp_path, governors)))
    assert set(_verdicts(found)) == {"kernel", "frequency", "processors"}
    assert set(_verdicts(found).values()) == {Level.NOTE}
    kernel, frequency, processors = (one.sentence for one in found)
    assert frequency == "governor powersave: a processor that slowed down begins a tick slowly"
    assert kernel == "Linux 6.1.0 without PREEMPT_RT: one of its longer sections can make a tick late"
    assert processors == "none of 8 is isolated: other programs share the controller's"
    remedies = " ".join(one.remedy for one in found)
    assert "cpupower frequency-set -g performance" in remedies
    assert "isolcpus=7 nohz_full=7" in remedies


@linux
def test_can_interfaces_are_those_of_the_kernels_type(tmp_path: Path) -> None:
    files = {
        "eth0/type": "1\n",
        "no-such-can0/type": "280\n",
        "no-such-can0/flags": "0x40080\n",
        "no-such-can1/type": "280\n",
        "no-such-can1/flags": "0x400c1\n",
    }
    down, up = (one for one in checks.check_can(_tree(tmp_path, files)) if one.subject == "CAN interface")
    assert (down.verdict, up.verdict) == (Level.NOTE, Level.OK)
    assert down.remedy == "sudo ip link set no-such-can0 up type can bitrate 1000000"
    assert "can:socketcan/no-such-can1" in up.sentence


@linux
def test_manufacturers_libraries_are_named_by_what_python_can_calls_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there = ["pcanbasic", "canlib"]
    monkeypatch.setattr("ctypes.util.find_library", lambda name: name if name in there else None)
    found = list(checks.check_can(tmp_path))
    assert found == [ok("CAN drivers", "manufacturers' libraries for python-can: pcan, kvaser")]
    there.remove("pcanbasic")
    (found_one,) = checks.check_can(tmp_path)
    assert found_one.sentence.endswith(": kvaser")


def test_a_machine_without_can_is_told_that_a_serial_line_needs_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ctypes.util.find_library", lambda _: None)
    (found,) = checks.check_can(tmp_path)
    assert found == ok("CAN", "no interface and no manufacturer's driver; a serial line needs none")


@linux
def test_a_folder_that_takes_no_recording_is_a_problem() -> None:
    (found,) = checks.check_disk(Path("/proc/self"))
    assert found.verdict is Level.PROBLEM
    assert found.sentence.startswith("/proc/self: a recording cannot be written")


@linux
def test_a_disk_that_is_full_is_a_problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.TemporaryFile", lambda **_: os.fdopen(os.open("/dev/full", os.O_WRONLY), "wb"))
    sentence = f"{tmp_path}: a recording cannot be written (No space left on device)"
    assert list(checks.check_disk(tmp_path)) == [problem("disk", sentence, "go to another folder, or free space")]


def test_a_package_of_another_version_is_a_problem() -> None:
    assert checks._unmet(Requirement("numpy>=1")) is None
    wrong, missing = checks._unmet(Requirement("numpy<1")), checks._unmet(Requirement("no-such-package"))
    assert wrong is not None
    assert missing is not None
    assert wrong.remedy == "pip install 'numpy<1'"
    assert missing.sentence == "no-such-package is not installed, any version is needed"


@pytest.mark.parametrize(
    ("version", "words"), [("2.1rc1", None), ("2.0", None), ("2.0rc1", "numpy is 2.0rc1, >=2 is needed")]
)
def test_a_version_before_its_release_counts_as_what_it_is(
    monkeypatch: pytest.MonkeyPatch, version: str, words: str | None
) -> None:
    monkeypatch.setattr("importlib.metadata.version", lambda _: version)
    found = checks._unmet(Requirement("numpy>=2"))
    assert found == (None if words is None else problem("package", words, "pip install 'numpy>=2'"))


@pytest.mark.parametrize(
    ("needed", "python"),
    [
        (">=3.12.0", ok("Python", "3.12.1rc1")),
        (None, ok("Python", "3.12.1rc1")),
        (">=3.12.1", problem("Python", "3.12.1rc1, where >=3.12.1 is needed", NEWER_PYTHON)),
    ],
)
def test_versions_and_extras_are_told(monkeypatch: pytest.MonkeyPatch, needed: str | None, python: Finding) -> None:
    monkeypatch.setattr("platform.python_version", lambda: "3.12.1rc1")
    monkeypatch.setattr("importlib.metadata.metadata", lambda _: {"Requires-Python": needed})
    monkeypatch.setattr("importlib.metadata.requires", lambda _: ["numpy>=1", 'no-such-package; extra == "more"'])
    monkeypatch.setattr(checks, "EXTRAS", ("here", "there", "gone", "lost"))
    monkeypatch.setattr(checks, "missing_of", lambda extra: extra in ("gone", "lost"))
    packages, extras = "all 1 are installed, in suitable versions", "here, there; not installed: gone, lost"
    assert list(checks.check_versions()) == [python, ok("packages", packages), ok("extras", extras)]
    monkeypatch.setattr("importlib.metadata.requires", lambda _: ["numpy<1"])
    monkeypatch.setattr(checks, "missing_of", lambda _: False)
    _, numpy, everything = checks.check_versions()
    assert (numpy.verdict, everything) == (Level.PROBLEM, ok("extras", "here, there, gone, lost"))
    monkeypatch.setattr(checks, "missing_of", lambda _: True)
    *_, nothing = checks.check_versions()
    assert nothing.sentence == "none; not installed: here, there, gone, lost"


def test_requirements_of_a_package_that_is_not_installed_are_not_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "OUR_PACKAGE", "no-such-package")
    (found,) = checks.check_versions()
    assert (found.verdict, found.remedy) == (Level.PROBLEM, "pip install -e .")
    assert found.sentence == "no-such-package is not installed, so its requirements are not known"


def test_a_library_not_built_from_its_sources_is_a_problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    there = tmp_path / "libold.so"
    there.touch()
    native = (
        WHEEL_HOST._replace(path=there),
        WHEEL_HOST._replace(path=tmp_path / "libgone.so", module="b.build"),
        WHEEL_HOST,
    )
    monkeypatch.setattr(checks, "_NATIVE", native)
    old, gone, own = (one for one in checks.check_native() if one.subject == "native library")
    assert (old.verdict, old.remedy) == (Level.PROBLEM, "python -m tools.build.wheel_host")
    assert old.sentence == "libold.so was not built from the present sources"
    assert (gone.sentence, gone.remedy) == ("libgone.so is not built", "python -m b.build")
    assert own.verdict is Level.OK


def test_an_fmu_that_cannot_be_opened_is_a_problem_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    (fmu,) = [built for built in checks._NATIVE if built.path.suffix == ".fmu"][:1]
    monkeypatch.setattr(checks, "_NATIVE", (fmu,))
    monkeypatch.setattr(checks, "is_checkout", lambda *_: False)
    monkeypatch.setattr(type(fmu), "is_current", lambda _: True)
    monkeypatch.setattr("pathlib.Path.is_file", lambda _: True)
    monkeypatch.setattr(archive, "platforms", lambda _: ["linux64", "win64"])
    assert list(checks.check_native()) == [ok("plant", f"{fmu.path.name}, for linux64, win64")]

    def damaged(_: Path) -> list[str]:
        raise BadInputError("it is no archive")

    monkeypatch.setattr(archive, "platforms", damaged)
    assert list(checks.check_native()) == [problem("plant", "it is no archive", "hil fmu build")]
    monkeypatch.setattr(type(fmu), "is_current", lambda _: False)
    (old,) = checks.check_native()
    assert (old.verdict, old.subject, old.remedy) == (Level.PROBLEM, "plant", "install the package again")


@pytest.mark.parametrize(
    ("free_bytes", "verdict", "words"),
    [  # at 700 kB a second
        (2_519_999_999, Level.NOTE, "2.5 GB free, about 1 h"),
        (2_520_000_000, Level.OK, "2.5 GB free, about 1 h"),
        (25_300_000_000, Level.OK, "25.3 GB free, about 10 h"),
    ],
)
def test_a_disk_must_hold_an_hour_of_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, free_bytes: int, verdict: Level, words: str
) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=free_bytes))
    (found,) = checks.check_disk(tmp_path / "not" / "yet")
    assert (found.verdict, found.subject) == (verdict, "disk")
    assert found.sentence == f"{tmp_path}: {words} of recording at 1 kHz"


@pytest.mark.parametrize(
    ("late_us", "verdict", "granted"),
    [
        (100.4, Level.OK, ()),
        (499.9, Level.OK, ("memory", "priority")),
        (500.0, Level.NOTE, ("priority",)),
        (2000.0, Level.NOTE, ("memory",)),
    ],
)
def test_sleeps_that_end_late_are_told_in_microseconds(
    monkeypatch: pytest.MonkeyPatch, late_us: float, verdict: Level, granted: tuple[str, ...]
) -> None:
    @contextlib.contextmanager
    def real_time(options: RealtimeTable) -> Iterator[SimpleNamespace]:
        assert not options.lock_memory, "all memory of this process is much, for a fifth of a second"
        yield SimpleNamespace(figures=lambda: {"granted": granted})

    monkeypatch.setattr(realtime, "real_time", real_time)
    percentiles = {"p50": 12.4, "p99": late_us}
    monkeypatch.setattr(checks, "_lateness", lambda: SimpleNamespace(percentiles_us=lambda: percentiles))
    (found,) = checks.check_lateness()
    priority = "priority" in granted
    assert (found.verdict, found.subject) == (verdict, "lateness")
    assert found.sentence == (
        f"200 sleeps of 1 ms, {'with' if priority else 'without'} real-time priority: late by 12 µs p50, "
        f"{late_us:.0f} µs p99"
    )
    if verdict is Level.NOTE:
        begin = "end other programs, or isolate a processor; until then" if priority else "see rtprio; until then"
        assert found.remedy.startswith(begin)


def test_each_sleep_is_a_tick_after_the_last_even_when_that_one_ended_late(monkeypatch: pytest.MonkeyPatch) -> None:
    class Clock:
        """Each tenth sleep ends 2.5 ticks late, each other one 1 µs."""

        def __init__(self) -> None:
            self.now = 7_000
            self.asleep: list[int] = []

        def now_ns(self) -> int:
            return self.now

        def wait_until(self, t_ns: int) -> int:
            self.asleep.append(t_ns - self.now)
            late = 2_500_000 if len(self.asleep) % 10 == 0 else 1_000
            self.now = t_ns + late
            return late

    clock = Clock()
    monkeypatch.setattr(checks, "WallClock", lambda: clock)
    late = checks._lateness()
    assert (len(clock.asleep), sum(late.counts), late.worst_ns) == (200, 200, 2_500_000)
    assert set(clock.asleep) == {TICK_NS}


@linux
@pytest.mark.parametrize(
    ("limit", "capable", "memory_bytes", "verdicts"),
    [
        (39, False, 65_536, (Level.NOTE, Level.NOTE)),
        (40, False, None, (Level.OK, Level.OK)),
        (0, True, 65_536, (Level.OK, Level.OK)),
    ],
)
def test_permissions_are_those_that_a_run_asks_for(
    monkeypatch: pytest.MonkeyPatch, limit: int, capable: bool, memory_bytes: int | None, verdicts: tuple[Level, Level]
) -> None:
    monkeypatch.setattr(realtime, "has_capability", lambda _: capable)
    monkeypatch.setattr(realtime, "priority_limit", lambda: limit)
    monkeypatch.setattr(realtime, "memory_limit_bytes", lambda: memory_bytes)
    monkeypatch.setattr(realtime, "DMA_LATENCY", Path("/proc/version"))  # which nobody may write
    monkeypatch.setattr("os.access", lambda path, mode: capable and (path, mode) == (Path("/proc/version"), os.W_OK))
    found = list(checks.check_permissions())
    assert [one.subject for one in found] == ["rtprio", "memlock", "idle states"]
    priority, memory, idle = found
    deep = "/proc/version may not be written: a processor may sleep so deep that it wakes late"
    assert (idle.verdict, idle.sentence) == (
        (Level.OK, "a run can forbid deep ones") if capable else (Level.NOTE, deep)
    )
    assert (priority.verdict, memory.verdict) == verdicts
    assert priority.sentence.startswith(f"real-time priority up to {99 if capable else limit}")
    if verdicts[0] is Level.NOTE:
        assert priority.sentence.endswith(", where a run asks for 40: other programs make ticks late")
        assert " - rtprio 40' | sudo tee -a " in priority.remedy
        assert memory.sentence.startswith("only 64 KiB may be locked")
        assert " - memlock unlimited' | sudo tee -a " in memory.remedy
    else:
        assert memory.sentence == "all memory may be locked"


@linux
def test_few_processors_are_not_asked_to_be_isolated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for count, subjects in ((2, {"kernel"}), (3, {"kernel", "processors"})):
        monkeypatch.setattr("os.cpu_count", lambda count=count: count)
        assert {found.subject for found in checks.check_kernel(tmp_path)} == subjects


@linux
def test_a_serial_port_is_judged_by_who_may_open_it_and_by_its_latency(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    timers = {"a/latency_timer": "16\n", "b/latency_timer": "1\n", "d/latency_timer": "2\n"}
    monkeypatch.setattr(checks, "_USB_SERIAL", _tree(tmp_path, timers))

    def port(name: str, vid: int | None = 1, hwid: str = "USB") -> SimpleNamespace:
        return SimpleNamespace(device=f"/dev/{name}", description=f"port {name}", vid=vid, hwid=hwid)

    ports = [port("a"), port("b"), port("c"), port("closed"), port("closed_board", None), port("none", hwid="n/a")]
    ports.insert(0, port("d"))
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: ports)
    monkeypatch.setattr("os.access", lambda device, mode: "closed" not in device and mode == os.R_OK | os.W_OK)
    two_ms, *found = checks.check_serial()
    assert two_ms.verdict is Level.NOTE
    assert two_ms.remedy.endswith(f"echo 1 | sudo tee {tmp_path}/d/latency_timer")
    assert {one.subject for one in found} == {"serial port"}
    assert [one.verdict for one in found] == [Level.NOTE, Level.OK, Level.OK, Level.PROBLEM, Level.NOTE]
    held = "its driver holds bytes back for 16 ms until a run sets it to low latency"
    assert found[0].sentence == f"/dev/a: port a; {held}"
    assert found[1].sentence == "/dev/b: port b; low latency, 1 ms"
    assert found[2].sentence == "/dev/c: port c"
    assert found[3].sentence == "/dev/closed: port closed; this user may not open it"
    assert found[3].remedy == "sudo usermod -aG dialout $USER, and log in again"
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: ports[-1:])
    assert list(checks.check_serial()) == [ok("serial ports", "none is plugged in")]


@linux
def test_a_port_is_opened_to_the_user_by_its_group(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    device = tmp_path / "port"
    device.touch()
    assert checks._remedy(device) == f"sudo usermod -aG {device.group()} $USER, and log in again"
    monkeypatch.setattr(sys, "platform", "win32")
    assert checks._remedy(device) == ""


def test_on_windows_a_port_is_not_asked_who_may_open_it(monkeypatch: pytest.MonkeyPatch) -> None:
    port = SimpleNamespace(device="COM3", description="FT232R", vid=1, hwid="USB")
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: [port])
    monkeypatch.setattr("os.access", lambda *_: False)
    monkeypatch.setattr(checks, "_WINDOWS", True)
    assert list(checks.check_serial()) == [ok("serial port", "COM3: FT232R")]


def test_what_linux_alone_has_is_not_looked_for_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = {"sys/kernel/realtime": "1\n", "can0/type": "280\n"}
    tree = _tree(tmp_path, files)
    monkeypatch.setattr(sys, "platform", "darwin")
    monkeypatch.setattr("ctypes.util.find_library", lambda _: None)
    assert [*checks.check_kernel(tree), *checks.check_permissions()] == []
    assert [one.subject for one in checks.check_can(tree)] == ["CAN"]
