"""Pictures: real PNG, SVG and PDF files, the same bytes for the same data, without pyplot."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from hil.core.errors import BadInputError
from hil.core.types import WHEEL_NAMES
from hil.pages.html_page import document, figure, mark, table
from hil.pages.plots import (
    REFERENCE_COLOUR,
    WHEEL_COLOURS,
    Curve,
    colour_of,
    draw_error,
    draw_path,
    draw_wheels,
    drawing,
    rgb,
)
from tests.support.processes import hil

NAN = float("nan")


def draw(path: Path) -> bytes:
    t_s = np.linspace(0.0, 3.0, 100)
    gap = np.where(t_s < 1.0, NAN, t_s)
    with drawing(path, columns=3) as (first, second, third):
        draw_path(
            first, Curve("reference", np.cos(t_s), np.sin(t_s)), [Curve("law", gap, t_s), Curve("none", t_s * NAN, t_s)]
        )
        draw_error(second, [Curve(str(number), t_s, 0.0 * t_s + number) for number in range(12)])
        draw_wheels(third, t_s, dict.fromkeys(WHEEL_NAMES, gap), title="torque", y_label="N·m")
        shown = {
            "least": min(float(line.get_ydata()[0]) for line in second.lines),
            "styles": {line.get_linestyle() for line in second.lines[1:]},
        }
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


def test_what_is_drawn_is_what_was_given_in_its_colour_and_unit() -> None:
    t_s, x_m, y_m = np.array([0.0, 0.5, 1.0]), np.array([NAN, 1.5, 2.0]), np.array([5.0, -3.0, -4.0])
    wheels = {wheel: t_s * place for place, wheel in enumerate(WHEEL_NAMES, start=1)}
    path, error, near, turning = Figure().subplots(1, 4)
    draw_path(path, Curve("asked", y_m, x_m), [Curve("own", x_m, y_m, (51, 102, 204)), Curve("next", y_m, x_m)])
    draw_error(error, [Curve("own", t_s, np.array([0.25, 0.002, 4e-6])), Curve("far", t_s, t_s + 1.0, dashed=True)])
    draw_error(near, [Curve("at the least", t_s, np.full(3, 1e-5))])
    draw_wheels(turning, t_s, wheels, title="Speed", y_label="rad/s")

    def lines(axes) -> list[tuple]:
        data = [(line.get_label(), *(list(one) for one in line.get_data())) for line in axes.lines]
        return [one for one in data if not one[0].startswith("_")]

    np.testing.assert_equal(
        lines(path), [("asked", [5, -3, -4], [NAN, 1.5, 2]), ("own", [NAN, 1.5, 2], [5, -3, -4]),
                      ("next", [5, -3, -4], [NAN, 1.5, 2])],
    )  # fmt: skip
    begins = [
        (*(list(one) for one in line.get_data()), line.get_color()) for line in path.lines if line.get_marker() == "o"
    ]
    assert begins == [([1.5], [-3.0], (0.2, 0.4, 0.8)), ([-3.0], [1.5], rgb(colour_of(1)))]
    assert [line.get_color() for line in path.lines[:3]] == [rgb(REFERENCE_COLOUR), (0.2, 0.4, 0.8), rgb(colour_of(1))]
    assert (path.get_xlabel(), path.get_ylabel(), path.get_title()) == ("x [m]", "y [m]", "Path")
    assert path.get_aspect() == 1.0
    assert lines(error) == [("own", [0.0, 0.5, 1.0], [250.0, 2.0, 0.01]), ("far", [0.0, 0.5, 1.0], [1e3, 1.5e3, 2e3])]
    assert list(error.lines[0].get_ydata()) == [10.0, 10.0], "the error of t10"
    assert [line.is_dashed() for line in error.lines[1:]] == [False, True]
    assert error.get_title() == "Planar error, drawn from 0.01 mm"
    assert (error.get_xlabel(), error.get_ylabel()) == ("t [s]", "planar error [mm]")
    assert lines(turning) == [(wheel.upper(), [0.0, 0.5, 1.0], values.tolist()) for wheel, values in wheels.items()]
    assert [line.get_color() for line in turning.lines] == [rgb(colour) for colour in WHEEL_COLOURS]
    assert (turning.get_ylabel(), turning.get_title()) == ("rad/s", "Speed")
    assert near.get_title() == "Planar error"


def test_a_page_escapes_its_texts_loads_nothing_and_says_which_columns_are_numbers() -> None:
    rows = table(("law", "t10 [s]", "why"), [("<b>pid</b>", "1.5", "-"), ("lqi", "2", "x")], numbers=(1,))
    assert "".join(rows) == (
        '<table><thead><tr><th class="t">law</th><th class="n">t10 [s]</th><th class="t">why</th></tr></thead><tbody>'
        '<tr><td class="t"><b>pid</b></td><td class="n">1.5</td><td class="t">-</td></tr>'
        '<tr><td class="t">lqi</td><td class="n">2</td><td class="t">x</td></tr></tbody></table>'
    )
    assert mark("a < b", True) == '<span class="passed">a &lt; b</span>'
    assert mark("no", False) == '<span class="failed">no</span>'
    heading, picture = figure("Speed & way", "of <fl>", lambda axes: axes[1].plot([0.0, 1.0]), height_in=2.0, rows=2)
    assert heading == "<h2>Speed &amp; way</h2>"
    assert picture.startswith('<figure><svg role="img" aria-label="Speed &amp; way" ')
    assert picture.endswith("</svg>\n<figcaption>of &lt;fl&gt;</figcaption></figure>")
    assert re.search(r'width="518\.4pt" height="144pt"', picture), "7.2 and 2 inches of 72 points"
    assert "<metadata>" not in picture
    assert "<g id=" not in picture
    plain, scripted = document("A & b", ["<p>one</p>", "<p>two</p>"]), document("A", [], "'sha256-x'")
    policy = "default-src 'none'; style-src 'unsafe-inline'"
    assert f'content="{policy}">' in plain
    assert f"content=\"{policy}; script-src 'sha256-x'; img-src data: blob:\">" in scripted
    assert "<title>A &amp; b</title>" in plain
    assert plain.endswith("<h1>A &amp; b</h1>\n<p>one</p>\n<p>two</p>\n</body></html>\n")


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
    assert all(len(text.strip("0.")) == 1 for text in shown if "e" not in text), shown


def test_an_unwritable_picture_is_a_sentence_and_one_that_failed_is_no_file(tmp_path) -> None:
    with pytest.raises(BadInputError, match=r"picture .*none/a\.png: it cannot be written \(No such file"):
        draw(tmp_path / "none" / "a.png")
    with pytest.raises(ZeroDivisionError), drawing(tmp_path / "c.png"):
        raise ZeroDivisionError
    assert not (tmp_path / "c.png").exists()


@pytest.mark.parametrize(
    "command",
    [["compare", "pid", "circle_speed", "--html", "page.html"], ["reproduce", "--quick"], ["campaign", "report", "."]],
)
def test_a_command_refuses_another_format_before_it_begins(tmp_path, monkeypatch, command) -> None:
    monkeypatch.chdir(tmp_path)
    done = hil(*command, "--pictures", "jpg")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "hil: --pictures jpg: expected png, svg or pdf\n"
    assert list(tmp_path.iterdir()) == []
