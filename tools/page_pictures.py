"""Take the pictures of a review's page that the documents show: ``python -m tools.page_pictures FOLDER``.

Makes a run of each kind (passed, failed, ended early, with faults), reviews it, and takes its page in a
real browser at 1280 pixels. The page of the failed run is also taken at 390 pixels, as on a phone, and as printed.
"""

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from io import BytesIO
from pathlib import Path

import pypdfium2
from PIL import Image

from hil.addons.report.difference import signal_differences
from hil.addons.report.panels import read_for_page
from hil.addons.report.review_page import page
from hil.judge.recorded import judged_run
from hil.pages.html_page import write_document
from tools.browser import BrowserError, Page, browser
from tools.example_runs import make_runs

DRAWN = "document.body.dataset.drawn === 'yes'"
_WIDE, _PHONE = (1280, 860), (390, 844)
_COLOURS = 256


def write_page(recordings: Sequence[Path], file: Path, asked: Sequence[str] = ()) -> None:
    """Write the page of one recording, or of two with the signals to compare."""
    runs = [read_for_page(path) for path in recordings]
    signals = signal_differences(runs[0], runs[1], asked) if len(runs) == 2 else None
    write_document(file, page(runs, [judged_run(run) for run in runs], signals))


def take(view: Page, file: Path) -> Iterator[tuple[str, bytes]]:
    """Yield what a browser shows of a page: "" as on a desk, and of the failed run "phone" and "printed"."""
    view.open("about:blank")
    view.resize(*_WIDE)
    view.open(file.as_uri())
    view.wait_until(DRAWN, 60.0)
    yield "", view.picture()
    if file.stem == "failed":
        yield "printed", _first_page(view.printed())
        view.resize(*_PHONE, is_phone=True)
        view.wait_until("document.querySelector('.main-svg').getBoundingClientRect().width < 390", 10.0)
        yield "phone", view.picture()


def _first_page(pdf: bytes) -> bytes:
    buffer = BytesIO()
    pypdfium2.PdfDocument(pdf)[0].render(scale=1.4).to_pil().save(buffer, "PNG")
    return buffer.getvalue()


def main() -> int:
    """Run the command line; 0 when all pictures were written."""
    parser = argparse.ArgumentParser(description="Take the pictures of a review's page that the documents show.")
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    try:
        with tempfile.TemporaryDirectory() as scratch, browser() as view:
            recordings = make_runs(Path(scratch))
            pages = {name: [path] for name, path in recordings.items() if name != "other law"}
            pages["pair"] = [recordings["passed"], recordings["other law"]]
            for name, paths in pages.items():
                html = Path(scratch) / f"{name}.html"
                write_page(paths, html, ["error.planar_m"] if name == "pair" else ())
                for kind, png in take(view, html):
                    file = folder / f"page_{'_'.join(filter(None, (name, kind)))}.png"
                    with Image.open(BytesIO(png)) as image:
                        image.convert("RGB").quantize(_COLOURS).save(file, optimize=True)
                    print(file, file.stat().st_size)
    except BrowserError as error:
        print(f"page_pictures: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
