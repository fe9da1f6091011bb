"""Take a picture of a recording as a viewer shows it: ``python tools/screenshot.py RUN.rrd OUT.png``.

Starts a viewer without a window, with the layout that the recording ships. It needs a Vulkan driver; one in
software will do: ``apt-get install -y mesa-vulkan-drivers libvulkan1``.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image
from rerun.experimental import View, ViewerClient

from hil.errors import HilError
from hil.telemetry.view import HOST, free_port, live_address, viewer_executable, wait_until_listening

MOST_SHOTS = 100
NOTICES_FADE_S = 6.0
BAR_PX = 37


class ScreenshotError(Exception):
    """No picture could be taken, or the picture shows a broken view."""


def take_screenshot(recording: Path, picture: Path, *, at_least_s: float = 0.0) -> list[View]:
    """Write a PNG of the viewer's views and return them; ``at_least_s`` lets the viewer's notices fade.

    Shots are taken until two in a row are alike: everything has been loaded and drawn then. Raises
    ScreenshotError when the recording does not load, a view reports a problem, or no two shots are alike;
    DeviceError when the viewer does not start.
    """
    with _headless_viewer() as viewer:
        viewer.open(str(recording.resolve()))
        _settle(viewer, picture, at_least_s)
        state = viewer.get_state()
    if not state.recordings or not state.views:
        raise ScreenshotError(f"{recording}: the viewer shows no recording")
    problems = [f"{view.name}: {report.summary}" for view in state.views for report in view.reports]
    if problems:
        raise ScreenshotError(f"{recording}: {'; '.join(problems)}")
    return state.views


@contextmanager
def _headless_viewer() -> Iterator[ViewerClient]:
    port = free_port()
    # Not ViewerClient.spawn(): a viewer of its making listens on every interface.
    command = [
        str(viewer_executable()),
        "--headless",
        "--hide-welcome-screen",
        "--bind",
        HOST,
        "--port",
        str(port),
    ]
    viewer = subprocess.Popen(command, stderr=subprocess.DEVNULL, env={**os.environ, "RUST_LOG": "off"})
    try:
        wait_until_listening(viewer, port)
        yield ViewerClient.connect(live_address(port))
    finally:
        viewer.terminate()
        viewer.wait()


def _settle(viewer: ViewerClient, picture: Path, at_least_s: float) -> None:
    earliest = time.monotonic() + at_least_s
    with tempfile.TemporaryDirectory() as directory:
        shot = Path(directory) / "shot.png"
        before = b""
        for _ in range(MOST_SHOTS):
            viewer.save_screenshot(str(shot))
            now = shot.read_bytes()
            if now == before and time.monotonic() >= earliest and not viewer.get_state().loading:
                _without_bar(shot, picture)
                return
            before = now
    raise ScreenshotError(f"no two of {MOST_SHOTS} shots were alike: the viewer is still drawing")


def _without_bar(shot: Path, picture: Path) -> None:
    """Write the shot without the window's own bar, which says nothing about the run."""
    with Image.open(shot) as image:
        image.crop((0, BAR_PX, image.width, image.height)).save(picture, optimize=True)


def main() -> int:
    """Run the command line; 0 when the picture was written."""
    parser = argparse.ArgumentParser(description="Take a picture of a recording as a viewer shows it.")
    parser.add_argument("recording", type=Path)
    parser.add_argument("picture", type=Path)
    options = parser.parse_args()
    if not options.recording.is_file():
        print(f"screenshot: {options.recording}: no such file", file=sys.stderr)
        return 2
    try:
        views = take_screenshot(options.recording, options.picture, at_least_s=NOTICES_FADE_S)
    except (HilError, ScreenshotError, RuntimeError, OSError) as error:
        print(f"screenshot: {error}", file=sys.stderr)
        return 1
    print(f"{options.picture}: {len(views)} views, none broken")
    return 0


if __name__ == "__main__":
    sys.exit(main())
