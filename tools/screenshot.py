"""Take a picture of a recording as a viewer shows it: ``python -m tools.screenshot RUN.rrd OUT.png``.

Starts a viewer without a window, with the layout that the recording ships. It needs a Vulkan driver; one in
software will do: ``apt-get install -y mesa-vulkan-drivers libvulkan1``.

``python -m tools.screenshot --examples tools/pictures`` makes a run of each kind (``example_runs.py``),
and takes the pictures of RECORDING.md.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from PIL import Image
from PIL.PngImagePlugin import PngInfo
from rerun.experimental import View, ViewerClient

from hil.addons.report.viewer import (
    Window,
    free_port,
    live_address,
    viewer_command,
    viewer_environment,
    wait_until_listening,
)
from hil.core.errors import HilError
from tools.example_runs import make_runs

MOST_SHOTS = 100
NOTICES_FADE_S = 6.0
BAR_PX = 37
_CONTAINER = "ContainerBlueprint"

EXAMPLES: Mapping[str, tuple[str, str | None]] = {
    # name of the picture: the run, and the tab to show
    "passed": ("passed", None),
    "failed": ("failed", None),
    "ended": ("ended", None),
    "faulty": ("faulty", None),
    "faulty_transients": ("faulty", "Transients 1"),
}
_COLOURS = 200
TABS = "Tabs"
"""Keyword of the text in a picture that has the names of the tabs, for a test that compares them with the layout's."""


class ScreenshotError(Exception):
    """No picture could be taken, or the picture shows a broken view."""


def take_screenshot(
    recording: Path, picture: Path, *, tab: str | None = None, at_s: float | None = None, at_least_s: float = 0.0
) -> list[View]:
    """Write a PNG of the viewer's views and return those that were shown.

    ``tab`` is the name of the one to show, by default the one that the recording opens with; ``at_s`` the time under
    the cursor, by default the end; ``at_least_s`` lets the viewer's notices fade. Raises as ``take_screenshots``.
    """
    return take_screenshots(recording, {tab: picture}, at_s=at_s, at_least_s=at_least_s)


def take_screenshots(
    recording: Path, pictures: Mapping[str | None, Path], *, at_s: float | None = None, at_least_s: float = 0.0
) -> list[View]:
    """Write a PNG of each tab that is named, and return the views that were shown. Raises as ``take_with``."""
    with headless_viewer() as viewer:
        return take_with(viewer, recording, pictures, at_s=at_s, at_least_s=at_least_s)


def take_with(
    viewer: ViewerClient,
    recording: Path,
    pictures: Mapping[str | None, Path],
    *,
    at_s: float | None = None,
    at_least_s: float = 0.0,
) -> list[View]:
    """Open a recording in a viewer, write a PNG of each tab that is named, and return the views that were shown.

    Shots are taken until two in a row are alike: everything has been loaded and drawn then. Raises
    ScreenshotError when the recording does not load, has no such tab, a view reports a problem, or no two shots are
    alike; DeviceError when the viewer does not start.
    """
    viewer.open(str(recording.resolve()))
    for tab, picture in pictures.items():
        if tab is not None:
            _show_tab(viewer, tab)
        if at_s is not None:
            viewer.set_time("t", duration=at_s, play_state="paused")
        settle(viewer, picture, at_least_s)
        at_least_s = 0.0
    # A view's reports are those of the last time that it was shown.
    state = viewer.get_state()
    if not state.recordings or not state.views:
        raise ScreenshotError(f"{recording}: the viewer shows no recording")
    problems = [f"{view.name}: {report.summary}" for view in state.views for report in view.reports]
    if problems:
        raise ScreenshotError(f"{recording}: {'; '.join(problems)}")
    return state.views


def take_examples(folder: Path) -> None:
    """Make the example runs and write each of ``EXAMPLES``, small, as ``hil view`` opens it.

    Raises as ``take_screenshots``.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as directory:
        recordings = make_runs(Path(directory))
        for name, (run, tab) in EXAMPLES.items():
            picture = folder / f"viewer_{name}.png"
            with headless_viewer() as viewer:
                viewer.open(str(recordings[run]))
                if tab is not None:
                    _show_tab(viewer, tab)
                Window(int(viewer.url.split(":")[2].split("/")[0])).point_at_violation(is_open=lambda: True)
                settle(viewer, picture, NOTICES_FADE_S)
            with Image.open(picture) as image:
                _save(image.convert("RGB").quantize(_COLOURS), picture, image.info[TABS])
            print(f"{picture}: {picture.stat().st_size / 1000:.0f} kB")


def tabs(recording: Path) -> list[str]:
    """Return the names of the tabs of the layout that a recording ships."""
    with headless_viewer() as viewer:
        viewer.open(str(recording.resolve()))
        return list(_tabs(viewer.get_blueprint().blueprint)[1])


def _show_tab(viewer: ViewerClient, name: str) -> None:
    shown = viewer.get_blueprint()
    root, found = _tabs(shown.blueprint)
    if name not in found:
        raise ScreenshotError(f"there is no tab {name!r}; there are {', '.join(found)}")
    shown.blueprint[root][_CONTAINER]["active_tab"] = found[name]
    viewer.set_blueprint(shown.blueprint, "recording")


def _tabs(blueprint: Mapping[str, Any]) -> tuple[str, dict[str, str]]:
    """Return the path of the container of tabs, and the tabs' own paths by name."""
    root = next(path for path, held in blueprint.items() if "active_tab" in held.get(_CONTAINER, {}))
    paths = blueprint[root][_CONTAINER]["contents"]
    return root, {blueprint[f"/{path}"][_CONTAINER]["display_name"]: path for path in paths}


@contextmanager
def headless_viewer() -> Iterator[ViewerClient]:
    """Give a viewer without a window, on this machine alone, that ends with the context."""
    port = free_port()
    # Not ViewerClient.spawn(): a viewer of its making listens on every interface.
    command = viewer_command("--headless", "--hide-welcome-screen", "--port", str(port))
    viewer = subprocess.Popen(command, stderr=subprocess.DEVNULL, env={**viewer_environment(), "RUST_LOG": "off"})
    try:
        wait_until_listening(viewer, port)
        yield ViewerClient.connect(live_address(port))
    finally:
        viewer.terminate()
        viewer.wait()


def settle(viewer: ViewerClient, picture: Path, at_least_s: float) -> None:
    """Write a PNG once two shots in a row are alike, after ``at_least_s``. Raises ScreenshotError if none are."""
    earliest = time.monotonic() + at_least_s
    with tempfile.TemporaryDirectory() as directory:
        shot = Path(directory) / "shot.png"
        before = b""
        for _ in range(MOST_SHOTS):
            try:
                viewer.save_screenshot(str(shot))
            except TimeoutError:  # on a busy machine a picture may take longer than rerun waits for it
                continue
            now = shot.read_bytes()
            if now == before and time.monotonic() >= earliest and not viewer.get_state().loading:
                _without_bar(shot, picture, _tabs(viewer.get_blueprint().blueprint)[1])
                return
            before = now
    raise ScreenshotError(f"no two of {MOST_SHOTS} shots were alike: the viewer is still drawing")


def _without_bar(shot: Path, picture: Path, names: Iterable[str]) -> None:
    """Write the shot without the window's own bar, which says nothing about the run, and with the tabs' names."""
    with Image.open(shot) as image:
        _save(image.crop((0, BAR_PX, image.width, image.height)), picture, ", ".join(names))


def _save(image: Image.Image, picture: Path, names: str) -> None:
    text = PngInfo()
    text.add_text(TABS, names)
    image.save(picture, optimize=True, pnginfo=text)


def main() -> int:
    """Run the command line; 0 when the picture was written."""
    parser = argparse.ArgumentParser(description="Take a picture of a recording as a viewer shows it.")
    parser.add_argument("recording", type=Path, nargs="?")
    parser.add_argument("picture", type=Path, nargs="?")
    parser.add_argument("--examples", type=Path, metavar="DIR", help="make the example runs and write their pictures")
    parser.add_argument("--tab", help="the tab to show; by default the one that the recording opens with")
    parser.add_argument("--at", type=float, metavar="SECONDS", help="the time under the cursor; by default the end")
    options = parser.parse_args()
    if options.examples is not None:
        take_examples(options.examples)
        return 0
    if options.recording is None or options.picture is None:
        parser.error("expected RUN.rrd OUT.png, or --examples DIR")
    if not options.recording.is_file():
        print(f"screenshot: {options.recording}: no such file", file=sys.stderr)
        return 2
    try:
        views = take_screenshot(
            options.recording, options.picture, tab=options.tab, at_s=options.at, at_least_s=NOTICES_FADE_S
        )
    except (HilError, ScreenshotError, RuntimeError, OSError) as error:
        print(f"screenshot: {error}", file=sys.stderr)
        return 1
    print(f"{options.picture}: {len(views)} views, none broken")
    return 0


if __name__ == "__main__":
    sys.exit(main())
