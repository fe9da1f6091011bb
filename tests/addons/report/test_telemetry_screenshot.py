"""The layout that a recording ships, as a real viewer draws it."""

import io
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun
from PIL import Image

from hil.addons.report.viewer import (
    Window,
    free_port,
    on_each_run,
    viewer_command,
    viewer_environment,
    wait_until_listening,
)
from hil.core.signals import SIGNAL_NAMES, pack_row
from hil.pages.plots import HEADING_COLOUR, REFERENCE_COLOUR, TRUTH_COLOUR, WHEEL_COLOURS, X_COLOUR, Y_COLOUR, Colour
from hil.record.recording import Recording
from hil.runtime.provenance import properties
from hil.scenario import load
from tests.support.processes import wait_for
from tests.support.recorded_circle import circle_rows
from tools.browser import chromium
from tools.screenshot import settle

DRIVERS = [Path("/usr/share/vulkan/icd.d"), Path("/etc/vulkan/icd.d")]

pytestmark = pytest.mark.skipif(
    not any(directory.is_dir() and any(directory.iterdir()) for directory in DRIVERS),
    reason="needs a Vulkan driver: apt-get install -y mesa-vulkan-drivers libvulkan1",
)


# Of each tab colours of what it draws of the run. A run of one row, and a legend, has 180 pixels of each at most.
DATA: dict[str, Sequence[Colour]] = {
    "Verdict": (REFERENCE_COLOUR, Y_COLOUR, HEADING_COLOUR),
    "Transients": (Y_COLOUR, HEADING_COLOUR),
    "Wheels": WHEEL_COLOURS,
    "Law": (X_COLOUR, Y_COLOUR, HEADING_COLOUR),
    "Link and loop": (TRUTH_COLOUR, REFERENCE_COLOUR),
    "Estimator and sensors": (HEADING_COLOUR,),
    "Run": (),  # text
}
ELSEWHERE = (
    "https://tel.rerun.io/api/pog",  # counts its use
    "https://api.github.com/repos/rerun-io/rerun/releases/latest",  # looks for a newer version
    f"https://app.rerun.io/version/{rerun.__version__}/examples_manifest.json",  # what its first page offers
    "https://fonts.googleapis.com/css2?family=Inter:wght@100;500&display=swap",  # while it loads
)
VIEWS = (
    "Verdict",
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
        recorder.put(pack_row((*row, 0.5)))


@pytest.fixture(scope="module")
def viewer() -> Iterator[Any]:
    """One viewer for all tests here: it takes seconds to start."""
    from tools.screenshot import headless_viewer

    with headless_viewer() as started:
        yield started


def test_every_view_of_every_tab_of_a_recording_is_drawn_with_its_data(viewer: Any, tmp_path: Path) -> None:
    from tools.screenshot import ScreenshotError, take_with

    recording = tmp_path / "run.rrd"
    pictures = {tab: tmp_path / f"{tab}.png" for tab in DATA}
    told = properties(load("paper_circle"))
    with Recording(recording, properties=told, blocking=True, signals=SIGNALS) as recorder:
        record(recorder)
        assert recorder.finish({"passed": True}).complete
    views = take_with(viewer, recording, pictures)
    assert [report for view in views for report in view.reports] == []
    for part in VIEWS:
        assert any(view.name.startswith(part) for view in views), part
    for tab, picture in pictures.items():
        for colour in DATA[tab]:
            assert _pixels_of(picture.read_bytes(), colour) > 500, (tab, colour)
    assert len({picture.read_bytes() for picture in pictures.values()}) == len(DATA)
    with pytest.raises(ScreenshotError, match="there is no tab 'Wheel'; there are Verdict, Transients, Wheels"):
        take_with(viewer, recording, {"Wheel": tmp_path / "none.png"})


def test_the_viewer_opens_with_the_cursor_at_the_first_violation(tmp_path: Path) -> None:
    from tools.screenshot import headless_viewer

    recording, told = tmp_path / "run.rrd", tmp_path / "told.toml"
    told.write_text('extends = "paper_circle"\n[[expect]]\nsignal = "error.planar_m"\nfrom_s = 0.4\nbelow = 0.01\n')
    with Recording(recording, properties=properties(load(told)), blocking=True, signals=SIGNALS) as recorder:
        record(recorder)
        assert recorder.finish({"passed": False, "why": [], "expect": []}).complete
    pictures = [tmp_path / f"{name}.png" for name in ("opened", "violation", "end")]
    with headless_viewer() as viewer:  # a new one, as for `hil view`: a viewer keeps the layout of its first run
        viewer.open(str(recording))
        Window(int(viewer.url.split(":")[2].split("/")[0])).point_at_violation(is_open=lambda: True)
        for picture, at_s in zip(pictures, (None, 0.4, 1.599), strict=True):
            if at_s is not None:
                viewer.set_time("t", duration=at_s, play_state="paused")
            settle(viewer, picture, 0.0)
    opened, violation, end = (_cursor_px(picture) for picture in pictures)
    assert opened == violation
    assert opened < end


@pytest.mark.skipif(shutil.which("strace") is None, reason="needs strace")
def test_the_viewer_asks_no_other_machine(tmp_path: Path) -> None:
    """Every connection of a viewer that loads a recording is to this machine."""
    recording, calls = tmp_path / "run.rrd", tmp_path / "calls.txt"
    with Recording(recording, properties={}, blocking=True, signals=SIGNALS) as recorder:
        record(recorder)
        recorder.finish({"passed": True})
    port = free_port()
    traced = ["strace", "--follow-forks", "--trace=connect,sendto,sendmmsg", f"--output={calls}", "--quiet=all"]
    command = [*traced, *viewer_command("--headless", "--port", str(port), str(recording))]
    environment = {**viewer_environment(), "HOME": str(tmp_path), "RUST_LOG": "off"}
    with subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL, start_new_session=True) as started:
        try:
            wait_until_listening(started, port)
            Window(port).point_at_violation(is_open=lambda: True)  # returns when all is loaded
            wait_for(lambda: 'sin_port=htons(9), sin_addr=inet_addr("127.0.0.1")' in calls.read_text())
        finally:
            os.killpg(started.pid, signal.SIGTERM)
    others = [
        line for line in calls.read_text().splitlines() if "sa_family=AF_INET" in line and "127.0.0.1" not in line
    ]
    assert others == []
    assert not list(tmp_path.rglob("analytics*"))


def test_a_viewer_that_is_open_shows_a_run_that_begins_and_the_next_one_after_it(viewer: Any) -> None:
    port, ended = free_port(), threading.Event()
    before = {shown.store_id for shown in viewer.get_state().recordings}
    window = Window(int(viewer.url.split(":")[2].split("/")[0]))
    arguments = {"found": lambda: window.show(port), "is_watching": lambda: not ended.is_set()}
    watcher = threading.Thread(target=on_each_run, args=(port,), kwargs=arguments)
    watcher.start()
    try:
        first = _shown_run(viewer, port, other_than=before)
        assert _shown_run(viewer, port, other_than={*before, first}) != first
    finally:
        ended.set()
        watcher.join()


def _shown_run(viewer: Any, port: int, *, other_than: set[str]) -> str:
    """Serve a run live and return its id in the viewer, another than some, once its last row is there."""
    with _served(port):
        deadline = time.monotonic() + 60.0
        while time.monotonic() < deadline:
            for shown in viewer.get_state().recordings:
                ends = {timeline.name: timeline.end for timeline in shown.timelines}
                if shown.store_id not in other_than and (ends.get("tick") or 0) >= 1580:
                    return str(shown.store_id)
            time.sleep(0.05)
    raise AssertionError("the viewer does not show the run")


@pytest.mark.skipif(chromium() is None, reason="needs a browser: apt-get install -y chromium")
def test_a_page_of_a_real_browser_shows_the_run() -> None:
    from tools.browser import browser

    port = free_port()
    command = [sys.executable, "-m", "hil.cli.main", "live", "--web", "--port", str(port)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as live:
        try:
            assert live.stdout is not None
            sentence = live.stdout.readline()
            address = next(word for word in sentence.split() if word.startswith("http://127.0.0.1:"))
            # A small page: it is drawn in software.
            with browser(960, 600) as page, _served(port):
                page.open(f"{address}&renderer=webgl")
                assert not _shows_a_trail(page.picture())
                page.wait_for(_shows_a_trail, 150.0)
                assert [error for error in page.errors if not _is_of_a_refusal(error)] == []
        finally:
            live.terminate()
        assert live.wait() == 0


@contextmanager
def _served(port: int) -> Iterator[None]:
    """Serve a made-up run live."""
    told = properties(load("paper_circle"))
    with Recording(None, properties=told, blocking=True, live_port=port, signals=SIGNALS) as recorder:
        record(recorder)
        recorder.finish({}, keep_live=True)
        yield


def _is_of_a_refusal(error: str) -> bool:
    """Tell whether an error says that our policy has kept rerun's page from an address elsewhere.

    rerun reports the same again, as a fetch that failed, without the address.
    """
    refused = "Content Security Policy" in error and any(address in error for address in ELSEWHERE)
    return refused or error.startswith("TypeError: Failed to fetch\n    at __wbg_fetch_")


def _cursor_px(picture: Path) -> int:
    """Return where the time cursor is in the panel at the bottom, from the left: the white triangle over its line."""
    with Image.open(picture) as image:
        panel = np.asarray(image.convert("RGB")).astype(int)[-28:-23, 230:-180]
    return int(np.median(np.flatnonzero((panel.min(axis=2) > 170).any(axis=0))))


def _shows_a_trail(picture: bytes) -> bool:
    """Tell whether a picture has an area of the colour in which the reference is drawn."""
    return _pixels_of(picture, REFERENCE_COLOUR) > 150


def _pixels_of(picture: bytes, colour: Colour) -> int:
    """Return how many pixels have a colour, or nearly."""
    with Image.open(io.BytesIO(picture)) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    return int((np.abs(pixels - colour).sum(axis=2) < 30).sum())
