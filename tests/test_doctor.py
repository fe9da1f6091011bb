"""``hil doctor``: on this machine as it is, and on trees as other machines have them."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from firmware_protocol.built import WHEEL_HOST
from hil.cli.checks import Finding, Verdict, install, ports, realtime, recording
from hil.cli.doctor import lines as lines_of
from hil.service.messages import Phase
from tests.processes import hil, wait_for
from tests.service_testbed import ControlSide

linux = pytest.mark.skipif(sys.platform != "linux", reason="the trees are Linux's")


def _verdicts(findings: list[Finding]) -> dict[str, Verdict]:
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
    assert subjects >= {"Python", "packages", "native library", "plant", "clock", "lateness", "disk", "viewer"}
    assert all(bool(found["remedy"]) is (found["verdict"] != "ok") for found in findings)
    assert not (tmp_path / "not").exists()


def test_findings_are_printed_with_what_to_do_below(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    lines = list(lines_of(list(install.check_native())))
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
    found = list(realtime.check_kernel(_tree(tmp_path, files)))
    assert set(_verdicts(found).values()) == {Verdict.OK}
    assert "isolated: 2, 3" in found[-1].sentence


@linux
def test_a_machine_that_was_not_gets_the_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 8)
    monkeypatch.setattr("platform.version", lambda: "#1 SMP PREEMPT_DYNAMIC")
    monkeypatch.setattr("platform.release", lambda: "6.1.0")
    governors = {f"sys/devices/system/cpu/cpu{n}/cpufreq/scaling_governor": "powersave\n" for n in range(8)}
    config = {"boot/config-6.1.0": "CONFIG_HZ=250\nCONFIG_NO_HZ_IDLE=y\n# CONFIG_HIGH_RES_TIMERS is not set\n"}
    found = list(realtime.check_kernel(_tree(tmp_path, governors | config)))
    assert set(_verdicts(found)) == {"kernel", "timers", "frequency", "processors"}
    assert set(_verdicts(found).values()) == {Verdict.NOTE}
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
    down, up = (one for one in ports.check_can(_tree(tmp_path, files)) if one.subject == "CAN interface")
    assert (down.verdict, up.verdict) == (Verdict.NOTE, Verdict.OK)
    assert down.remedy == "sudo ip link set no-such-can0 up type can bitrate 1000000"
    assert "can:socketcan/no-such-can1" in up.sentence


@linux
def test_a_folder_that_takes_no_recording_is_a_problem() -> None:
    (found,) = recording.check_disk(Path("/proc/self"))
    assert found.verdict is Verdict.PROBLEM
    assert found.sentence.startswith("/proc/self: a recording cannot be written")


def test_a_package_of_another_version_is_a_problem() -> None:
    assert install._unmet(Requirement("numpy>=1")) is None
    wrong, missing = install._unmet(Requirement("numpy<1")), install._unmet(Requirement("no-such-package"))
    assert wrong is not None
    assert missing is not None
    assert wrong.remedy == "pip install 'numpy<1'"
    assert missing.sentence == "no-such-package is not installed, any version is needed"


def test_a_library_not_built_from_its_sources_is_a_problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    there = tmp_path / "libold.so"
    there.touch()
    native = (
        WHEEL_HOST._replace(path=there),
        WHEEL_HOST._replace(path=tmp_path / "libgone.so", module="b.build"),
        WHEEL_HOST,
    )
    monkeypatch.setattr(install, "_NATIVE", native)
    old, gone, own = (one for one in install.check_native() if one.subject == "native library")
    assert (old.verdict, old.remedy) == (Verdict.PROBLEM, "python -m tools.build.wheel_host")
    assert old.sentence == "libold.so was not built from the present sources"
    assert (gone.sentence, gone.remedy) == ("libgone.so is not built", "python -m b.build")
    assert own.verdict is Verdict.OK


@linux
def test_a_graphics_processor_is_found_by_its_node(tmp_path: Path) -> None:
    (tmp_path / "renderD128").touch()
    assert _verdicts(list(recording.check_viewer(tmp_path)))["graphics"] is Verdict.OK
    assert _verdicts(list(recording.check_viewer(tmp_path / "none")))["graphics"] is Verdict.NOTE


def _examined(side: ControlSide) -> tuple[int, dict[str, dict[str, str]]]:
    assert side.child.token_file is not None
    which = ("--service", "--url", side.child.url, "--token-file", side.child.token_file)
    done = hil("doctor", *which, "--json")
    return done.returncode, {found["subject"]: found for found in json.loads(done.stdout)}


def test_a_running_service_is_examined(side: ControlSide) -> None:
    side.status = replace(side.status, frames={"sent": 10, "received": 9, "rejected": {}})
    wait_for(lambda: not side.request("GET", "/v1/status").json()["frames"]["rejected"])
    code, found = _examined(side)
    assert (code, {one["verdict"] for one in found.values()} - {"note"}) == (0, {"ok"}), found
    assert found["robot"]["sentence"] == "active"
    assert found["frames"]["sentence"] == "10 frames sent, 9 received, 0 rejected"


def test_what_is_wrong_with_a_running_service_is_said_with_a_remedy(side: ControlSide) -> None:
    side.status = replace(
        side.status,
        phase=Phase.FAULT,
        why="encoder fl stands",
        deadline_misses=600,
        recording="run.rrd",
        recording_trouble="No space left on device",
        feedback_age_ms=400.0,
        realtime={"priority": "priority: refused, no permission"},
    )
    wait_for(lambda: side.request("GET", "/v1/status").json()["phase"] == "fault")
    code, found = _examined(side)
    assert code == 1
    assert found["robot"]["sentence"] == "fault: encoder fl stands"
    wrong = {name: one["verdict"] for name, one in found.items() if one["verdict"] != "ok"}
    assert wrong.items() >= {
        "robot": "problem", "recording": "problem", "loop": "note", "frames": "note", "feedback": "note",
        "priority": "note",
    }.items()  # fmt: skip
    assert all(found[name]["remedy"] for name in wrong)


def test_a_service_is_chosen_only_for_service() -> None:
    refused = hil("doctor", "--port", "8770")
    assert (refused.returncode, "add --service" in refused.stderr) == (2, True)
