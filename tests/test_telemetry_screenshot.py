"""The layout that a recording ships, as a real viewer draws it."""

import io
import json
import struct
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from hil.scenario import load
from hil.signals import SIGNAL_NAMES
from hil.telemetry import Recording
from hil.telemetry.follow import Window, follow
from hil.telemetry.layout import REFERENCE_COLOUR
from hil.telemetry.provenance import properties
from hil.telemetry.view import free_port
from tests.recorded_circle import circle_rows
from tools.browser import chromium

DRIVERS = [Path("/usr/share/vulkan/icd.d"), Path("/etc/vulkan/icd.d")]

pytestmark = pytest.mark.skipif(
    not any(directory.is_dir() and any(directory.iterdir()) for directory in DRIVERS),
    reason="needs a Vulkan driver: apt-get install -y mesa-vulkan-drivers libvulkan1",
)


TABS = ["Robot", "Wheels", "Law", "Link and loop", "Estimator and sensors", "Run"]
VIEWS = (
    "Robot: ",
    "Plan",
    "Position error",
    "Heading error",
    "Wheel speed",
    "Torque command and limits",
    "Motor current",
    "Gain K1",
    "Gain K2",
    "States",
    "Events",
    "Lateness",
    "Round trip",
    "Frames",
    "Standard deviation",
    "fuzzy",
)
SIGNALS = (*SIGNAL_NAMES, "fuzzy.x.firing_number")


def record(recorder: Recording) -> None:
    """Give the recorder a made-up run."""
    recorder.event(0.0, "info", "ACTIVE")
    for row in circle_rows(1600):
        recorder.put((*row, 0.5))


def test_every_view_of_every_tab_of_a_recording_can_be_drawn(tmp_path: Path) -> None:
    from tools.screenshot import ScreenshotError, take_screenshot, take_screenshots

    recording = tmp_path / "run.rrd"
    pictures = {tab: tmp_path / f"{tab}.png" for tab in TABS}
    told = properties(load("paper_circle"))
    with Recording(recording, properties=told, blocking=True, signals=SIGNALS) as recorder:
        record(recorder)
        assert recorder.finish({"passed": True}).complete
    shown = {view.name for view in take_screenshots(recording, pictures)}
    for part in VIEWS:
        assert any(name.startswith(part) for name in shown), part
    for picture in pictures.values():
        header = picture.read_bytes()[:24]
        assert header.startswith(b"\x89PNG")
        width, height = struct.unpack(">II", header[16:24])
        assert width >= 1000
        assert height >= 600
    assert len({picture.read_bytes() for picture in pictures.values()}) == len(TABS)
    with pytest.raises(ScreenshotError, match="there is no tab 'Wheel'; there are Robot, Wheels"):
        take_screenshot(recording, tmp_path / "none.png", tab="Wheel")


def test_a_viewer_that_is_open_shows_a_run_that_begins_and_the_next_one_after_it() -> None:
    from tools.screenshot import headless_viewer

    port, ended = free_port(), threading.Event()
    with headless_viewer() as viewer:
        window = Window(int(viewer.url.split(":")[2].split("/")[0]))
        arguments = {"found": lambda: window.show(port), "going_on": lambda: not ended.is_set()}
        follower = threading.Thread(target=follow, args=(port,), kwargs=arguments)
        follower.start()
        try:
            first = _shown_run(viewer, port, not_this=None)
            assert _shown_run(viewer, port, not_this=first) != first
        finally:
            ended.set()
            follower.join()


def _shown_run(viewer: Any, port: int, *, not_this: str | None) -> str:
    """Serve a run live and return its id in the viewer, another than one before, once its last row is there."""
    with _served(port):
        deadline = time.monotonic() + 60.0
        while time.monotonic() < deadline:
            for shown in viewer.get_state().recordings:
                ends = {timeline.name: timeline.end for timeline in shown.timelines}
                if shown.store_id != not_this and (ends.get("tick") or 0) >= 1590:
                    return str(shown.store_id)
            time.sleep(0.05)
    raise AssertionError("the viewer does not show the run")


@pytest.mark.skipif(chromium() is None, reason="needs a browser: apt-get install -y chromium")
def test_a_page_of_a_real_browser_shows_the_run_and_is_told_of_the_next_one() -> None:
    from tools.browser import browser

    port = free_port()
    command = [sys.executable, "-m", "hil.cli", "live", "--web", "--port", str(port)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as live:
        try:
            assert live.stdout is not None
            sentence = live.stdout.readline()
            address = next(word for word in sentence.split() if word.startswith("http://127.0.0.1:"))
            # A small page: it is drawn in software.
            with browser(960, 600) as page, _served(port):
                page.open(f"{address}?renderer=webgl")
                assert not _shows_a_trail(page.picture())
                page.wait_for(_shows_a_trail, 150.0)
                assert not [error for error in page.errors if "ERROR" in error]
            _wait_for_run(address, 1)
            with _served(port):
                _wait_for_run(address, 2)
        finally:
            live.terminate()
        assert live.wait() == 0


def _wait_for_run(address: str, number: int) -> None:
    """Return once the page is told of so many runs."""
    deadline = time.monotonic() + 30.0
    while time.monotonic() < deadline:
        with urllib.request.urlopen(f"{address}run") as answer:
            if json.load(answer)["number"] == number:
                return
        time.sleep(0.05)
    raise AssertionError(f"the page is not told of run {number}")


@contextmanager
def _served(port: int) -> Iterator[None]:
    """Serve a made-up run live."""
    told = properties(load("paper_circle"))
    with Recording(None, properties=told, blocking=True, live_port=port, signals=SIGNALS) as recorder:
        record(recorder)
        recorder.finish({}, keep_live=True)
        yield


def _shows_a_trail(picture: bytes) -> bool:
    """Tell whether a picture has an area of the colour in which the reference is drawn."""
    with Image.open(io.BytesIO(picture)) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    return int((np.abs(pixels - REFERENCE_COLOUR).sum(axis=2) < 30).sum()) > 300
