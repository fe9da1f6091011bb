"""A maker's protocol of another package: what of it cannot be used is told before anything starts."""

import re
from pathlib import Path

import pytest

from hil.core.errors import BadInputError
from hil.robot.driver_registry import dialect, emulated
from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import load
from tests.support.outside import outside_package

DIALECTS = """
    from dataclasses import dataclass
    from hil.core.types import CommandMode
    from hil.robot.driver import Capabilities, Dialect, Driver

    @dataclass(frozen=True)
    class Settings:
        pass

    class Motors(Driver):
        identity = sample = None
        arm = command = disarm = feed = lambda *_: ()

        def __init__(self, *_):
            self._capabilities = Capabilities(1000.0, frozenset(), frozenset({CommandMode.SPEED}))

    motors = Dialect("motors", frozenset({"can"}), Settings, Motors, "json:JSONDecoder")
    wires = Dialect("motors", frozenset({"usb"}), Settings, Motors, "json:JSONDecoder")
    settings = Dialect("motors", frozenset({"can"}), 5, Motors, "json:JSONDecoder")
"""


@pytest.fixture(autouse=True)
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    points = {name: f"outside_package:{name}" for name in ("motors", "wires", "settings")}
    outside_package(tmp_path, monkeypatch, DIALECTS, {"hil.drivers": points})


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("wires", "wires = {'usb'}: expected some of can, can_fd, serial"),
        ("settings", "settings = 5: expected a dataclass of options"),
        ("motors", "'json:JSONDecoder' is no hil.robot.virtual.ClockedNode"),
    ],
)
def test_a_protocol_that_cannot_be_used_says_what_of_it(name: str, words: str) -> None:
    with pytest.raises(BadInputError) as refused:
        emulated(name) if name == "motors" else dialect(name)
    assert str(refused.value) == f"device.driver = {name!r}: {words}"


def test_motors_behind_a_link_have_no_lockstep() -> None:
    changes = {"device.driver": "motors", "controller.command": "speed", "controller.law": "profile"}
    scenario = load("paper_circle", set=changes | {"estimator.source": "odometry"}, link="can:socketcan/can9")
    sentence = (
        "the protocol of 'motors' has no STEP, so that its time cannot be advanced from outside; "
        "add --mode realtime, or run it within one process with --link memory:"
    )
    with pytest.raises(BadInputError, match=f"^{re.escape(sentence)}$"):
        run_scenario(scenario, RunOptions(allow_motion=True))
