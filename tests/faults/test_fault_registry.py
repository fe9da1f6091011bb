"""A kind of fault from another package: one file, and it acts on signals or frames as the shipped ones do."""

from pathlib import Path

import pytest

import hil
from hil.core.errors import BadInputError
from hil.faults.kinds import kinds
from tests.support.outside import outside_package
from tests.support.processes import hil as run_hil

DRIFT = """
    from hil.faults.kinds import Kind, Quantity

    def drift(row, chance):
        return lambda value, t_ns: value + row.value * (t_ns - row.start_ns) * 1e-9

    KIND = Kind(
        "drift", "signal", ("truth.x_m",), "`truth.x_m`", "The signal drifts away.", "ticks in which the value changed",
        {"start_s": 0.1, "value": 0.5}, Quantity("value", "1/s", "drift in a second", -10.0, 10.0), on_signal=drift,
    )
"""
SHORT = {"loop.duration_s": 0.3, "expect": []}


def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str, **names: str) -> None:
    outside_package(tmp_path, monkeypatch, source, {"hil.faults": names or {"drift": "outside_package:KIND"}})


def test_a_kind_of_another_package_acts_on_a_signal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, monkeypatch, DRIFT)
    sound = hil.run("circle_speed", set={**SHORT, "estimator.source": "odometry"})
    row = {"kind": "drift", "start_s": 0.1, "value": 0.5}
    drifted = hil.run(
        "circle_speed", set={**SHORT, "estimator.source": "odometry", "fault": [row]}, record=tmp_path / "run.mcap"
    )
    t_s = sound.signals["loop.t_s"]
    moved_m = drifted.signals["truth.x_m"] - sound.signals["truth.x_m"]
    assert moved_m == pytest.approx(0.5 * (t_s - 0.1) * (t_s >= 0.1), abs=1e-9)
    assert drifted.metrics["fault"][0]["applied"] == (t_s > 0.1).sum()
    assert "The signal drifts away." in run_hil("list", "faults").stdout


EVERY_THIRD = """
    from hil.faults.kinds import Kind

    def every_third(row, chance):
        count = 0

        def effect(direction, frames):
            nonlocal count
            count += 1
            return frames if count % 3 else []

        return effect

    KIND = Kind(
        "every_third", "link", ("command", "feedback"), "`command` or `feedback`", "Every third frame is lost.",
        "frames lost", {"target": "command"}, explains=True, on_frames=every_third,
    )
"""


def test_a_kind_of_another_package_acts_on_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, monkeypatch, EVERY_THIRD, every_third="outside_package:KIND")
    sound, faulty = (
        hil.run("circle_speed", set={**SHORT, "fault": faults}).metrics
        for faults in ([], [{"kind": "every_third", "target": "command"}])
    )
    assert faulty["failure"] is None
    assert faulty["fault"][0]["applied"] > 20
    sent, left = (one["link_statistics"]["sent"]["frames"] for one in (sound, faulty))
    assert sent - left == pytest.approx(faulty["fault"][0]["applied"], abs=2)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (('"drift", "signal"', '"drop", "signal"'), "expected a hil.faults.kinds.Kind of this name"),
        (
            ('"signal", (', '"plant", ('),
            "acts_on = 'plant'; expected 'signal' with on_signal, or 'link' with",
        ),
        (("on_signal=drift", "is_instant=True"), "acts_on = 'signal'; expected 'signal' with on_signal"),
        (("KIND =", "OTHER ="), "'outside_package:KIND' cannot be loaded: AttributeError"),
    ],
)
def test_a_package_whose_kind_cannot_be_used_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: tuple[str, str], problem: str
) -> None:
    install(tmp_path, monkeypatch, DRIFT.replace(*change))
    with pytest.raises(BadInputError, match=r"^fault 'drift', of the package outside-package: ") as told:
        kinds()
    assert problem in str(told.value)


def test_the_name_of_a_shipped_kind_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, monkeypatch, DRIFT.replace('"drift", "s', '"bias", "s'), bias="outside_package:KIND")
    with pytest.raises(BadInputError, match="of the package outside-package: the name is already in use"):
        kinds()
