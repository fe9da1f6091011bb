"""Pictures: real PNG, SVG and PDF files, the same bytes for the same data, without pyplot."""

import sys
from pathlib import Path

import numpy as np
import pytest

from hil.core.errors import BadInputError
from hil.core.types import WHEEL_NAMES
from hil.review.plots import Bar, Curve, draw_bars, draw_error, draw_path, draw_wheels, drawing
from tests.processes import hil

NAN = float("nan")


def draw(path: Path) -> bytes:
    t_s = np.linspace(0.0, 3.0, 100)
    gap = np.where(t_s < 1.0, NAN, t_s)
    with drawing(path, rows=2, columns=2) as (first, second, third, fourth):
        draw_path(
            first, Curve("reference", np.cos(t_s), np.sin(t_s)), [Curve("law", gap, t_s), Curve("none", t_s * NAN, t_s)]
        )
        draw_error(second, [Curve(str(number), t_s, 0.0 * t_s + number) for number in range(12)])
        draw_wheels(third, t_s, dict.fromkeys(WHEEL_NAMES, gap), title="torque", y_label="N·m")
        draw_bars(fourth, ["one", "two"], [Bar("law", [1.0, None], [2.0, None])], title="t10", y_label="s")
        shown = {
            "marked": [line.get_ydata()[0] for line in fourth.lines if len(line.get_ydata())],
            "told": fourth.get_legend_handles_labels()[1],
            "least": min(float(line.get_ydata()[0]) for line in second.lines),
            "styles": {line.get_linestyle() for line in second.lines[1:]},
        }
    assert shown["marked"] == [0.0], "a bar without a number is marked"
    assert "refused, or no figure" in shown["told"]
    assert shown["least"] > 0.0, "an error of zero has no logarithm"
    assert shown["styles"] == {"-", "--"}, "colours that come again are dashed"
    return path.read_bytes()


@pytest.mark.parametrize(("ending", "begin"), [("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF")])
def test_a_picture_has_the_format_of_its_ending_and_the_same_bytes_for_the_same_data(tmp_path, ending, begin) -> None:
    first = draw(tmp_path / f"a.{ending}")
    assert first.startswith(begin)
    assert first == draw(tmp_path / f"b.{ending}")
    assert "matplotlib.pyplot" not in sys.modules, "it would want a display"
    with pytest.raises(BadInputError, match=r"a\.jpg: its name must end in \.png, \.svg or \.pdf"):
        draw(tmp_path / "a.jpg")


def test_a_legend_hides_no_data_and_names_each_label_once(tmp_path) -> None:
    t_s = np.linspace(0.0, 1.0, 50)
    curves = [Curve(f"a law with a long name, number {number}", t_s, t_s * number) for number in range(1, 7)]
    with drawing(tmp_path / "a.svg", columns=2) as both:
        for axes in both:
            draw_error(axes, curves)
        figure = both[0].get_figure(root=True)
    assert figure is not None
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [curve.label for curve in curves]
    frame = legend.get_window_extent()
    assert not any(frame.overlaps(axes.get_tightbbox()) for axes in both)
    assert 0.0 <= frame.x0 < frame.x1 <= figure.bbox.width


@pytest.mark.parametrize(("low", "high"), [(0.004, 30.0), (0.3, 0.9), (2.0, 8.0), (1e-4, 1e4)])
def test_a_logarithmic_axis_reads_half_a_second_and_not_a_power_of_ten(tmp_path, low, high) -> None:
    with drawing(tmp_path / "a.svg") as (axes,):
        axes.set_yscale("log")
        axes.plot([0.0, 1.0], [low, high])
    text = (tmp_path / "a.svg").read_text(encoding="utf-8")
    assert "times" not in text
    assert "$" not in text
    shown = [
        tick.get_text() for tick in (*axes.get_yticklabels(), *axes.get_yticklabels(minor=True)) if tick.get_text()
    ]
    assert sum(low <= float(text) <= high for text in shown) >= 1, shown
    assert all("e" not in text for text in shown if 1e-4 <= float(text) < 1e5), shown


def test_an_unwritable_picture_is_a_sentence_and_one_that_failed_is_no_file(tmp_path) -> None:
    with pytest.raises(BadInputError, match=r"picture .*none/a\.png: it cannot be written \(No such file"):
        draw(tmp_path / "none" / "a.png")
    with pytest.raises(ValueError, match="shorter"), drawing(tmp_path / "c.png") as (axes,):
        draw_bars(axes, ["one", "two"], [Bar("law", [1.0], [1.0])], title="", y_label="")
    assert not (tmp_path / "c.png").exists()


@pytest.mark.parametrize(
    "command",
    [["compare", "pid", "circle_speed", "--out", "pictures"], ["reproduce", "--quick"], ["campaign", "report", "."]],
)
def test_a_command_refuses_another_format_before_it_begins(tmp_path, monkeypatch, command) -> None:
    monkeypatch.chdir(tmp_path)
    done = hil(*command, "--pictures", "jpg")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "hil: --pictures jpg: expected png, svg or pdf\n"
    assert list(tmp_path.iterdir()) == []
