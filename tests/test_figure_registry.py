"""Figures: one registry, open to other packages."""

import json
from pathlib import Path

import numpy as np
import pytest

import hil
from hil.core.errors import BadInputError
from hil.judge.figures import SHIPPED, figures, signal_figures, table_figures
from hil.judge.words import figure_rows
from hil.review.figures import review
from tests.outside import outside_package

GREATEST_SPEED = """
    import numpy as np
    from hil.judge.measure import Figure, NoFigureError

    class GreatestSpeed:
        figures = (Figure("greatest_speed_m_s", "greatest speed", "m/s", 1.0, "largest forward speed", column="speed"),)
        signals = ("loop.t_s", "twist.vx_m_s")

        def __init__(self, setup):
            self.greatest = -np.inf

        def add(self, signals):
            self.greatest = max(self.greatest, signals["twist.vx_m_s"].max(initial=-np.inf))

        def value(self, name):
            if self.greatest < 0.0:
                raise NoFigureError("the robot only drove backwards")
            return float(self.greatest)
"""
SHORT = {"loop.duration_s": 0.2, "expect": []}


def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str, name: str = "greatest_speed_m_s") -> None:
    outside_package(tmp_path, monkeypatch, source, {"hil.figures": {name: "outside_package:GreatestSpeed"}})


def test_every_figure_has_a_name_of_its_own_and_says_what_it_is() -> None:
    every = figures()
    assert len({figure.name for figure in every}) == len(every)
    assert all(figure.label and figure.meaning and figure.better in ("less", "more", None) for figure in every)
    assert {figure.name for kind in SHIPPED for figure in kind.figures} < {figure.name for figure in every}
    assert "steady_rms_m" in table_figures()


def test_a_figure_of_another_package_is_in_the_run_its_reports_and_its_review(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, monkeypatch, GREATEST_SPEED)
    recording = tmp_path / "run.mcap"
    result = hil.run("circle_speed", set=SHORT, record=recording)
    expected = float(result.signals["twist.vx_m_s"].max())
    assert json.loads(json.dumps(result.metrics))["greatest_speed_m_s"] == expected
    assert ("greatest speed", f"{expected:.5g} m/s") in list(figure_rows(result.metrics))
    assert review(recording)["greatest_speed_m_s"] == expected
    assert table_figures()["speed"].unit == "m/s"


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (('signals["twist.vx_m_s"].max(', 'signals["twist.vx"].max('), "GreatestSpeed failed: KeyError: 'twist.vx'"),
        (("return float(self.greatest)", "return 1.0 / 0.0"), "GreatestSpeed failed: ZeroDivisionError: "),
        (("if self.greatest < 0.0", "if True"), "the robot only drove backwards"),
        (('"twist.vx_m_s")', '"my.signal")'), "the run has no signal my.signal"),
    ],
)
def test_a_figure_that_fails_has_a_reason_and_ends_no_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: tuple[str, str], reason: str
) -> None:
    install(tmp_path, monkeypatch, GREATEST_SPEED.replace(*change))
    signals = {"loop.t_s": np.arange(3.0), "twist.vx_m_s": np.ones(3)}
    found, reasons = signal_figures(signals)
    assert found["greatest_speed_m_s"] is None
    assert reason in reasons["greatest_speed_m_s"]
    assert found["ticks"] == 3


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (('"greatest_speed_m_s"', '"ticks"'), "the name 'ticks' is already in use; choose another"),
        (("def value", "def values"), "'outside_package:GreatestSpeed' has no value; expected a class as hil.judge"),
        (("class GreatestSpeed", "class Other"), "'outside_package:GreatestSpeed' cannot be loaded: AttributeError"),
    ],
)
def test_a_package_whose_figure_cannot_be_used_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: tuple[str, str], problem: str
) -> None:
    install(tmp_path, monkeypatch, GREATEST_SPEED.replace(*change))
    with pytest.raises(BadInputError, match=r"^figure 'greatest_speed_m_s', of the package outside-package: ") as told:
        figures()
    assert problem in str(told.value)
