"""The layouts beside an export name what PlotJuggler and Foxglove find in it, in the form that these programs read."""

import csv
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

import hil
from hil.core.errors import BadInputError
from hil.review.export import write_export
from hil.review.reader import RecordedRun, read


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RecordedRun:
    path = tmp_path_factory.mktemp("layouts") / "run.mcap"
    hil.run("circle_speed", record=path, set={"loop.duration_s": 0.2, "expect": []})
    return read(path)


def fields(path: Path) -> set[str]:
    """Return the dotted names of the numbers in a message on /hil, by another decoder than ours."""

    def leaves(message: Any, prefix: str) -> Iterator[str]:
        for name in message.__slots__:
            value = getattr(message, name)
            yield from leaves(value, f"{prefix}{name}.") if hasattr(value, "__slots__") else [prefix + name]

    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return set(leaves(next(reader.iter_decoded_messages(topics=["/hil"]))[3], ""))


def curves(layout: Path) -> list[str]:
    """Return the curves of a layout of PlotJuggler, each of them in a plot of a tab of its window."""
    root = ElementTree.parse(layout).getroot()
    assert root.tag == "root"
    window = root.find("tabbed_widget")
    assert window is not None
    assert window.get("parent") == "main_window"
    for splitter in window.iterfind("Tab/Container/DockSplitter"):
        sizes = [float(size) for size in str(splitter.get("sizes")).split(";")]
        assert int(str(splitter.get("count"))) == len(sizes) == len(splitter.findall("DockArea/plot"))
        assert sum(sizes) == pytest.approx(1.0, abs=1e-4)
    found = window.findall("Tab/Container/DockSplitter/DockArea/plot/curve")
    assert all(re.fullmatch("#[0-9a-f]{6}", str(curve.get("color"))) for curve in found)
    return [str(curve.get("name")) for curve in found]


def test_the_layouts_beside_an_mcap_file_name_its_fields(run: RecordedRun, tmp_path: Path) -> None:
    write_export(run, tmp_path / "run.mcap")
    known = fields(tmp_path / "run.mcap")
    names = curves(tmp_path / "run.mcap.plotjuggler.xml")
    assert {"/hil/error/planar_m", "/hil/wheel/fl/speed_rad_s"} <= set(names)
    assert {name.removeprefix("/hil/").replace("/", ".") for name in names} <= known
    layout = json.loads((tmp_path / "run.mcap.foxglove.json").read_text())
    panels = layout["configById"]
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", ())]
    assert {path.removeprefix("/hil.") for path in paths} <= known
    assert len(paths) == len(names)

    def shown(tree: Any) -> Iterator[str]:
        yield from [tree] if isinstance(tree, str) else [*shown(tree["first"]), *shown(tree["second"])]

    tabs = [name for tab in panels["Tab!run"]["tabs"] for name in shown(tab["layout"])]
    assert sorted([*shown(layout["layout"]), *tabs]) == sorted(panels)
    view = panels["3D!robot"]
    with (tmp_path / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        moves = [message for *_, message in reader.iter_decoded_messages(topics=["/tf"])]
        topics = {channel.topic for channel in reader.get_summary().channels.values()}
    frames = {transform.child_frame_id for message in moves for transform in message.transforms}
    assert view["followTf"] in frames
    assert {frame.removeprefix("frame:") for frame in view["transforms"]} < frames
    assert set(view["topics"]) < topics


def test_the_layout_beside_a_table_names_its_columns_and_none_that_is_empty(run: RecordedRun, tmp_path: Path) -> None:
    write_export(run, tmp_path / "run.csv")
    with (tmp_path / "run.csv").open() as file:
        rows = list(csv.DictReader(file))
    names = curves(tmp_path / "run.csv.plotjuggler.xml")
    assert all(any(row[name] for row in rows) for name in names)
    axis = ElementTree.parse(tmp_path / "run.csv.plotjuggler.xml").find("Plugins/plugin/default")
    assert axis is not None
    assert axis.get("time_axis") in rows[0]
    assert not (tmp_path / "run.csv.foxglove.json").exists()


def test_a_layout_that_exists_is_not_replaced(run: RecordedRun, tmp_path: Path) -> None:
    (tmp_path / "run.csv.plotjuggler.xml").write_text("mine")
    with pytest.raises(BadInputError, match=r"plotjuggler\.xml"):
        write_export(run, tmp_path / "run.csv")
    assert not (tmp_path / "run.csv").exists()
    write_export(run, tmp_path / "run.csv", "replace")
    assert curves(tmp_path / "run.csv.plotjuggler.xml")
