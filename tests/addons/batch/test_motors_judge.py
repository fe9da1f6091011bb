"""The catalogue over motors of other makers: sound ones pass, and unsafe ones do not."""

from pathlib import Path
from typing import Any

import pytest

import hil.runtime.robots
from hil.addons.batch.catalogue.trials import JudgedTrial, Request, alone
from hil.addons.motors.moteus.emulated_moteus import EmulatedMoteus
from hil.core.errors import BadInputError
from hil.core.types import FourWheels
from tests.support.trials import done_here


def asked(driver: str, folder: Path, *kinds: str) -> Request:
    return Request("circle_speed", [f"device.driver={driver}", "loop.rate_hz=200"], [], list(kinds), folder)


def verdict(folder: Path, name: str, driver: str = "moteus") -> JudgedTrial:
    request = asked(driver, folder)
    [trial] = [trial for trial in alone(request) if trial.fault == name]
    return done_here(request, trial)


@pytest.mark.parametrize("name", ["no command", "disconnect link", "bit_errors command"])
def test_sound_motors_pass(tmp_path: Path, name: str) -> None:
    assert verdict(tmp_path, name).verdict == "ok"


class DrivesOn(EmulatedMoteus):
    """Its watchdog never runs out."""

    def tick(self) -> FourWheels | None:
        for servo in self.servos:
            servo.timeout_s = 1.0
        return super().tick()


class Pushes(EmulatedMoteus):
    """Gives torque of its own for a while, whatever it is told."""

    def tick(self) -> FourWheels | None:
        torque = super().tick()
        return (4.0, 0.0, 0.0, 0.0) if 800 < self.ticks < 1000 else torque


class Never(EmulatedMoteus):
    """Gives a torque that is no number, once."""

    def run(self, ticks: int) -> None:
        super().run(ticks)
        if self.ticks == 900:
            self.torque_n_m = (float("nan"), 0.0, 0.0, 0.0)
            self.on_tick(self)


@pytest.mark.parametrize(
    ("kind", "sentence"),
    [(Pushes, "fl is driven away from what was asked"), (Never, "the drives were given a torque that is no number")],
)
def test_unsafe_motors_do_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: type[Any], sentence: str) -> None:
    monkeypatch.setattr(hil.runtime.robots, "emulated", lambda _name: kind)
    assert "unsafe: " in (told := verdict(tmp_path, "push force_y_n").verdict)
    assert sentence in told


@pytest.mark.parametrize(
    ("kind", "sentence"), [(EmulatedMoteus, "ok"), (DrivesOn, "is driven away from what was asked")]
)
def test_a_watchdog_that_does_nothing_is_noticed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: type[EmulatedMoteus], sentence: str
) -> None:
    """No command gets there from 0.2 s on, for longer than the host's own patience and a ramp."""
    monkeypatch.setattr(hil.runtime.robots, "emulated", lambda _name: kind)
    request = asked("moteus", tmp_path)
    [trial] = [trial for trial in alone(request) if trial.fault == "no command"]
    gone = {"kind": "drop", "target": "command", "start_s": 0.2, "end_s": 1.25, "value": 1.0}
    assert sentence in done_here(request, trial._replace(rows=[gone])).verdict


def test_motors_that_nothing_stops_are_refused(tmp_path: Path) -> None:
    for driver in ("c620", "rosmaster"):
        with pytest.raises(BadInputError, match="and a watchdog, without which nothing stops the wheels"):
            alone(asked(driver, tmp_path))
