"""Take a picture of a recording as a viewer shows it: ``python tools/screenshot.py RUN.rrd OUT.png``.

Starts a headless rerun viewer with the blueprint that the recording ships. It needs a Vulkan driver, a
software one will do: ``apt-get install -y mesa-vulkan-drivers libvulkan1``.
"""

import argparse
import socket
import sys
import tempfile
from pathlib import Path

from rerun.experimental import ViewerClient

from hil.telemetry.view import viewer_executable

MOST_SHOTS = 12


class ScreenshotError(Exception):
    """No picture could be taken, or the picture shows a broken view."""


def take_screenshot(recording: Path, picture: Path) -> list[str]:
    """Write a PNG of the whole viewer and return the names of the views in it.

    Shots are taken until two in a row are alike, so that everything has been loaded and drawn. Raises
    ScreenshotError when the recording does not load, a view reports a problem, or no two shots are alike.
    """
    with ViewerClient.spawn(
        headless=True,
        port=_free_port(),
        hide_welcome_screen=True,
        executable_path=str(viewer_executable()),
    ) as viewer:
        viewer.open(str(recording.resolve()))
        viewer.run_command("ui.toggle_top_panel")  # the window's own bar says nothing about the run
        _settle(viewer, picture)
        state = viewer.get_state()
    if not state.recordings:
        raise ScreenshotError(f"{recording}: the viewer did not load it")
    problems = [f"{view.name}: {report.summary}" for view in state.views for report in view.reports]
    if problems:
        raise ScreenshotError(f"{recording}: {'; '.join(problems)}")
    return [view.name for view in state.views if view.visible]


def _settle(viewer: ViewerClient, picture: Path) -> None:
    with tempfile.TemporaryDirectory() as directory:
        shot = Path(directory) / "shot.png"
        before = b""
        for _ in range(MOST_SHOTS):
            viewer.save_screenshot(str(shot))
            now = shot.read_bytes()
            if now == before and not viewer.get_state().loading:
                picture.write_bytes(now)
                return
            before = now
    raise ScreenshotError(f"no two of {MOST_SHOTS} shots were alike: the viewer is still drawing")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


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
        views = take_screenshot(options.recording, options.picture)
    except (ScreenshotError, RuntimeError) as error:
        print(f"screenshot: {error}", file=sys.stderr)
        return 1
    print(f"{options.picture}: {len(views)} views: {', '.join(views)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
