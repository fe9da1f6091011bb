"""Pictures: real PNG files, the same bytes for the same data, without pyplot."""

import sys
from pathlib import Path

import numpy as np
import pytest

from hil.core.errors import BadInputError
from hil.core.types import WHEEL_NAMES
from hil.review.plots import Bar, Curve, draw_bars, draw_error, draw_path, draw_wheels, drawing

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
            "told": [text.get_text() for text in fourth.get_legend().get_texts()],
            "least": min(float(line.get_ydata()[0]) for line in second.lines),
            "styles": {line.get_linestyle() for line in second.lines[1:]},
        }
    assert shown["marked"] == [0.0], "a bar without a number is marked"
    assert "refused, or no figure" in shown["told"]
    assert shown["least"] > 0.0, "an error of zero has no logarithm"
    assert shown["styles"] == {"-", "--"}, "colours that come again are dashed"
    return path.read_bytes()


def test_a_picture_is_a_png_and_the_same_for_the_same_data(tmp_path) -> None:
    first = draw(tmp_path / "a.png")
    assert first.startswith(b"\x89PNG")
    assert first == draw(tmp_path / "b.png")
    assert "matplotlib.pyplot" not in sys.modules, "it would want a display"


def test_an_unwritable_picture_is_a_sentence_and_one_that_failed_is_no_file(tmp_path) -> None:
    with pytest.raises(BadInputError, match=r"picture .*none/a\.png: it cannot be written \(No such file"):
        draw(tmp_path / "none" / "a.png")
    with pytest.raises(ValueError, match="shorter"), drawing(tmp_path / "c.png") as (axes,):
        draw_bars(axes, ["one", "two"], [Bar("law", [1.0], [1.0])], title="", y_label="")
    assert not (tmp_path / "c.png").exists()
