"""Layouts of PlotJuggler and Foxglove for an exported run: errors, wheels, link and loop in plots; the robot in 3D."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from hil.core.outputs import Existing, whole_file
from hil.record.frames import ODOM, RobotFrames
from hil.record.layout import Colour, Entity, layout
from hil.record.mcap_file import EVENTS_TOPIC, ROBOT_TOPIC, SIGNALS_TOPIC
from hil.record.properties import scenario_values
from hil.record.robot_model import BASE_LINK, WHEEL_LINKS
from hil.review.reader import RecordedRun

_TABS: Mapping[str, Sequence[str]] = {
    "Errors": ("/ctrl/error/position", "/ctrl/error/heading", "/robot/state_code", "/ctrl/guard"),
    "Wheels": ("/ctrl/wheel/command/speed", "/ctrl/wheel/speed", "/ctrl/wheel/command/torque", "/ctrl/wheel/current"),
    "Link and loop": ("/loop/timing", "/link/age", "/link/delay", "/link/frames"),
    "Estimator": ("/ctrl/estimator/sigma", "/ctrl/estimator/fixes", "/ctrl/estimator/state", "/robot/gyro"),
}
"""The plots of each tab, by the entities of a recording that they show."""


def layout_files(export: Path) -> tuple[Path, ...]:
    """Return the names of the layouts beside an export: PlotJuggler's, and Foxglove's for an ``.mcap`` file."""
    kinds = (".plotjuggler.xml", ".foxglove.json") if export.suffix == ".mcap" else (".plotjuggler.xml",)
    return tuple(export.with_name(export.name + kind) for kind in kinds)


def write_layouts(run: RecordedRun, export: Path, existing: Existing) -> None:
    """Write the layouts beside an export; ``existing`` says what to do if a file exists. Raises OSError."""
    texts = [_plotjuggler(run, export), _foxglove(run)]
    for file, text in zip(layout_files(export), texts, strict=False):
        with whole_file(file, "layout", existing) as unfinished:
            unfinished.write_text(text, encoding="utf-8")


def _plots(run: RecordedRun) -> Iterator[tuple[str, list[Entity]]]:
    """Yield the name of each tab and its plots, of the signals that have a value."""
    known = [name for name, values in run.signals.items() if np.isfinite(values).any()]
    entities = {entity.path: entity for entity in layout(known)}
    for tab, paths in _TABS.items():
        if plots := [entities[path] for path in paths if path in entities]:
            yield tab, plots


def _hex(colour: Colour) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)


def _plotjuggler(run: RecordedRun, export: Path) -> str:
    """Return a layout of PlotJuggler 3. Its curves have the names that it gives to a file's fields or columns."""
    root = ElementTree.Element("root")
    window = ElementTree.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    for tab, plots in _plots(run):
        page = ElementTree.SubElement(window, "Tab", containers="1", tab_name=tab)
        sizes = ";".join([f"{1 / len(plots):.6f}"] * len(plots))
        inside = ElementTree.SubElement(page, "Container")
        rows = ElementTree.SubElement(inside, "DockSplitter", orientation="-", count=str(len(plots)), sizes=sizes)
        for entity in plots:
            area = ElementTree.SubElement(rows, "DockArea", name=entity.path)
            plot = ElementTree.SubElement(
                area, "plot", mode="TimeSeries", style="Lines", flip_x="false", flip_y="false"
            )
            for series in entity.series:
                name = series.signal
                if export.suffix == ".mcap":
                    name = f"{SIGNALS_TOPIC}/{name.replace('.', '/')}"
                ElementTree.SubElement(plot, "curve", name=name, color=_hex(series.colour))
    ElementTree.SubElement(window, "currentTabIndex", index="0")
    ElementTree.SubElement(root, "use_relative_time_offset", enabled="1")
    plugins = ElementTree.SubElement(root, "Plugins")
    if export.suffix == ".csv":
        reader = ElementTree.SubElement(plugins, "plugin", ID="DataLoad CSV")
        ElementTree.SubElement(reader, "default", time_axis="loop.t_s", delimiter="0")
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _foxglove(run: RecordedRun) -> str:
    """Return a layout of Foxglove: tabs of plots, and beside them the robot, if the file has it, over the events."""
    panels: dict[str, Any] = {"Log!events": {"topicToRender": EVENTS_TOPIC, "searchTerms": []}}
    tabs = []
    for tab, plots in _plots(run):
        names = []
        for entity in plots:
            names.append(f"Plot!{entity.path.strip('/').replace('/', '_')}")
            panels[names[-1]] = {
                "title": entity.path.strip("/").replace("/", " "),
                "paths": [
                    {
                        "value": f"{SIGNALS_TOPIC}.{series.signal}",
                        "label": series.label,
                        "color": _hex(series.colour),
                        "enabled": True,
                        "timestampMethod": "receiveTime",
                    }
                    for series in entity.series
                ],
                "isSynced": True,
                "showLegend": True,
                "xAxisVal": "timestamp",
            }
        tabs.append({"title": tab, "layout": _stacked(names)})
    panels["Tab!run"] = {"activeTabIdx": 0, "tabs": tabs}
    beside: Any = "Log!events"
    if RobotFrames.of(list(run.signals), scenario_values(run.properties)) is not None:
        panels["3D!robot"] = _robot()
        beside = {"direction": "column", "first": "3D!robot", "second": "Log!events", "splitPercentage": 70}
    whole = {"direction": "row", "first": "Tab!run", "second": beside, "splitPercentage": 60}
    return json.dumps(
        {
            "configById": panels,
            "globalVariables": {},
            "userNodes": {},
            "playbackConfig": {"speed": 1},
            "layout": whole,
        },
        indent=1,
    )


def _robot() -> dict[str, Any]:
    """Return Foxglove's settings of a 3D view, in which a URDF is not shown by itself, with a grid on the floor."""
    return {
        "cameraState": {"distance": 4, "perspective": True, "phi": 50, "thetaOffset": 45, "fovy": 45, "near": 0.05},
        "followMode": "follow-position",
        "followTf": BASE_LINK,
        "scene": {"transforms": {"axisScale": 0.3, "showLabel": True}},
        "transforms": {f"frame:{link}": {"visible": False} for link in WHEEL_LINKS},
        "topics": {ROBOT_TOPIC: {"visible": True}},
        "layers": {"grid": {"layerId": "foxglove.Grid", "visible": True, "frameId": ODOM, "size": 10, "divisions": 10}},
    }


def _stacked(names: Sequence[str]) -> Any:
    """Return panels one above the other, as Foxglove's tree of halves."""
    if len(names) == 1:
        return names[0]
    rest = _stacked(names[1:])
    return {"direction": "column", "first": names[0], "second": rest, "splitPercentage": 100 / len(names)}
