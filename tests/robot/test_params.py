"""`hil params`: the firmware's parameters over a real line, from a process of its own."""

import json
import re
from functools import partial
from pathlib import Path

import pytest

from firmware_protocol import codec
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from firmware_protocol.host import parameter_hash
from hil.core.errors import BadInputError, DeviceError
from hil.core.ports import Received
from hil.robot.parameters import ParameterClient, assignments
from hil.runtime.robots import firmware_values
from hil.scenario import load
from tests.support.processes import device, hil
from tests.support.wheel_rig import PARAMETERS, WheelRig


def test_parameters_are_shown_changed_and_kept(tmp_path: Path) -> None:
    with device("paper_circle", "--mode", "realtime", "--link", f"serial:pty?symlink={tmp_path}/robot") as robot:
        before = json.loads(hil("params", robot.link, "--json").stdout)
        assert before["speed_kp_n_m_s_rad"] == 1.100000023841858, "in single precision"
        changes = ("speed_kp_n_m_s_rad=1.5", "counts_per_revolution=2048", "watchdog_s=0.1")
        after = json.loads(hil("params", robot.link, *changes, "--store", "--json").stdout)
        assert (after["speed_kp_n_m_s_rad"], after["counts_per_revolution"]) == (1.5, 2048)
        head, *rows, _ = hil("params", robot.link).stdout.splitlines()
        assert head.split() == ["parameter", "type", "value", "range"]
        shown = {row.split()[0]: " ".join(row.split()[1:]) for row in rows}
        assert shown["speed_kp_n_m_s_rad"] == "float32 1.5 0 to 100"
        assert shown["counts_per_revolution"] == "uint32 2048 4 to 32768"
        assert shown["watchdog_s"] == "float32 0.1 0.02 to 0.1"
        restored = json.loads(hil("params", robot.link, "--restore", "--json").stdout)
        assert restored == before


@pytest.mark.parametrize("link", ["serial:pty", "memory:", "can:virtual/x"])
def test_a_link_that_reaches_no_robot_elsewhere_is_one_sentence(link) -> None:
    done = hil("params", link)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert f"link '{link}' reaches no robot outside this process" in done.stderr
    assert "serial:/dev/ttyACM0, or the link that 'hil device' prints" in done.stderr


def test_nothing_is_changed_unless_all_can_be_and_the_footer_is_of_what_is_in_force(tmp_path: Path) -> None:
    with device("paper_circle", "--mode", "realtime", "--link", f"serial:pty?symlink={tmp_path}/robot") as robot:
        done = hil("params", robot.link, "ramp_s=1", "--restore", "watchdog_s=5", "ramp=1")
        assert done.returncode == 2
        assert [line.partition(";")[0] for line in done.stderr.splitlines()] == [
            "hil: watchdog_s = 5",
            "the firmware has no parameter 'ramp'",
        ]
        footer = hil("params", robot.link, "speed_kp_n_m_s_rad=2").stdout.splitlines()[-1]
        in_force = firmware_values(load("paper_circle")) | {"speed_kp_n_m_s_rad": 2.0}
        assert f"parameters {parameter_hash(in_force):08x}" in footer


def test_a_wrong_parameter_is_one_sentence(tmp_path: Path) -> None:
    with device("paper_circle", "--mode", "realtime", "--link", f"serial:pty?symlink={tmp_path}/robot") as robot:
        for change, words in (
            ("speed_kp=1", "did you mean 'speed_kp_n_m_s_rad'?"),
            ("watchdog_s=5", "expected a number from 0.02 to 0.1"),
            ("speed_kp_n_m_s_rad=1e39", "speed_kp_n_m_s_rad = 1e+39; expected a number from 0 to"),
            ("counts_per_revolution=1e39", "expected a number from"),
            ("counts_per_revolution=7.5", "expected a whole number"),
            ("ramp_s", "expected NAME=NUMBER"),
            ("ramp_s=0.1 ramp_s=0.2", "ramp_s is given twice"),
            ("ramp_s=nan", "expected NAME=NUMBER"),
        ):
            done = hil("params", robot.link, *change.split())
            assert done.returncode == 2
            assert words in done.stderr
            assert done.stderr.count("\n") == 1


class RigLink:
    """A link to a firmware in this process, which is armed by another host after so many writes."""

    def __init__(self, writes: int = 1000) -> None:
        self.rig = WheelRig()
        self._writes = writes

    def send(self, frame: Frame) -> None:
        message = codec.decode(frame)
        if isinstance(message, m.ParameterRequest) and message.operation == m.Operation.WRITE:
            self._writes -= 1
            if self._writes < 0:
                self.rig.activate()
                self.rig.heard()
        self.rig.send(message)

    def receive(self, _timeout_ns: int) -> Received | None:
        return Received(frames, 0) if (frames := self.rig.frames()) else None

    def rejected(self) -> dict[str, int]:
        return {}


def test_a_change_that_is_refused_after_others_says_which_are_in_force() -> None:
    client = ParameterClient(RigLink(writes=1))
    changes = client.check({"ramp_s": PARAMETERS["ramp_s"], "speed_kp_n_m_s_rad": 2.0})
    with pytest.raises(DeviceError, match=r"not in IDLE; .*; changed before that, until the next reset: ramp_s$"):
        client.write(changes)
    assert {row.name: row.value for row in client.read()} == pytest.approx(PARAMETERS)


def test_a_change_that_is_refused_before_others_says_that_nothing_was_changed() -> None:
    client = ParameterClient(RigLink(writes=0))
    with pytest.raises(DeviceError, match=r"; nothing was changed$"):
        client.write(client.check({"ramp_s": 0.3}))


def test_a_change_that_is_refused_after_a_restore_says_that_all_are_those_of_the_build() -> None:
    client = ParameterClient(RigLink(writes=1))
    client.write(client.check({"ramp_s": 0.3}))
    client.restore()
    words = "not in IDLE; .*; changed before that, until the next reset: ramp_s, all to those of the build$"
    with pytest.raises(DeviceError, match=words):
        client.write(client.check({"watchdog_s": 0.04}))
    for order in (client.store, client.restore):
        with pytest.raises(DeviceError, match=words):
            order()


@pytest.mark.alone
def test_a_robots_file_is_written_into_its_firmware_which_then_arms(tmp_path: Path) -> None:
    file = tmp_path / "robot.toml"
    file.write_text("[firmware]\ntorque_limit_n_m = 1.5\n[robot]\nwheel_radius_m = 0.06\n")
    with device("circle_speed", "--mode", "realtime", "--link", f"serial:pty?symlink={tmp_path}/robot") as robot:
        run = ("run", "circle_speed", "--robot", file, "--link", robot.link, "--mode", "realtime", "--record", "none")
        run += ("--set", "loop.duration_s=0.2", "--set", "expect=[]", "--set", "estimator.source=odometry")
        refused = hil(*run)
        assert refused.returncode == 2
        assert "the robot's firmware parameters" in refused.stderr
        held = json.loads(hil("params", robot.link, "--robot", file, "ramp_s=0.2", "--json").stdout)
        assert (held["torque_limit_n_m"], held["wheel_radius_m"]) == (1.5, pytest.approx(0.06))
        assert hil(*run).returncode in (0, 1)


class Answers(RigLink):
    """A link on which each answer to an operation is changed, or is none."""

    def __init__(self, operation: m.Operation, **changes: int) -> None:
        super().__init__()
        self._operation, self._changes = operation, changes

    def receive(self, timeout_ns: int) -> Received | None:
        received = super().receive(timeout_ns)
        if received is None:
            return None
        frames = []
        for frame in received.frames:
            message = codec.decode(frame)
            if isinstance(message, m.ParameterResponse) and message.operation == self._operation:
                frames += [codec.encode(message._replace(**self._changes))] if self._changes else []
            else:
                frames.append(frame)
        return Received(frames, 0)


@pytest.mark.parametrize(
    ("operation", "changes", "words"),
    [
        (m.Operation.STORE, {"result": m.Result.STORAGE}, "refused to STORE a parameter: it cannot store parameters"),
        (m.Operation.STORE, {"result": m.Result.STATE}, "refused to STORE a parameter: it is not in IDLE; stop its"),
        (m.Operation.STORE, {"result": m.Result.PARAMETER}, "to STORE a parameter: it has no such parameter"),
        (m.Operation.STORE, {}, "the robot did not answer a parameter request within 4 s; check its power and the"),
        (m.Operation.STORE, {"transaction": 99}, "the robot did not answer a parameter request within 4 s"),
        (m.Operation.WRITE, {"result": m.Result.RANGE}, "the robot refused ramp_s: its range has changed; nothing was"),
    ],
)
def test_what_a_robot_refuses_or_does_not_answer_is_told(
    operation: m.Operation, changes: dict[str, int], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hil.robot.parameters._SILENCE_NS", 20_000_000)
    client = ParameterClient(Answers(operation, **changes))
    checked = client.check({"ramp_s": 0.3})
    ask = client.store if operation == m.Operation.STORE else partial(client.write, checked)
    with pytest.raises(DeviceError) as refused:
        ask()
    assert words in str(refused.value)


def test_assignments_are_numbers_by_name() -> None:
    assert assignments(["a=1.5", "b=-2"]) == {"a": 1.5, "b": -2.0}
    for texts, words in (
        (["=1"], "'=1': expected NAME=NUMBER"),
        (["a=x"], "'a=x': expected NAME=NUMBER"),
        (["a=inf"], "'a=inf': expected NAME=NUMBER"),
        (["a=1", "b=2", "a=0.25"], "a is given twice, as 1 and as 0.25; keep one of them"),
    ):
        with pytest.raises(BadInputError, match=re.escape(words)):
            assignments(texts)
