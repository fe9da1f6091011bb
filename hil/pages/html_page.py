"""Self-contained pages: one HTML file with its style and its plots as SVG, for the screen and for print."""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from html import escape
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from hil.core.outputs import Existing, write_whole
from hil.core.printable import printable
from hil.pages.plots import drawing
from hil.record.files import check_output_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_STYLE = Path(__file__).with_name("page.css")
# The page must not load anything from elsewhere.
_POLICY = "default-src 'none'; style-src 'unsafe-inline'"
WIDTH_IN = 7.2
"""The width of a picture on a page."""


def document(title: str, parts: Iterable[str], scripts: str = "") -> str:
    """Return an HTML page; ``parts`` are HTML already, ``scripts`` the sources of scripts that it allows."""
    policy = f"{_POLICY}; script-src {scripts}; img-src data: blob:" if scripts else _POLICY
    return "\n".join(
        [
            "<!doctype html>",
            '<html lang="en"><head><meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
            '<meta name="viewport" content="width=device-width">',
            f"<title>{escape(title)}</title><style>{_STYLE.read_text(encoding='utf-8').strip()}</style></head><body>",
            f"<h1>{escape(title)}</h1>",
            *parts,
            "</body></html>\n",
        ]
    )


def write_document(path: Path, text: str, existing: Existing = "refuse") -> None:
    """Write a page; ``existing`` says what to do if the file exists.

    Raises BadInputError when its name does not end in .html, and when it cannot be written.
    """
    check_output_path("page", path, existing)
    write_whole(path, printable(text).encode("utf-8"), "page", existing)


def figure(
    title: str, caption: str, draw: "Callable[[list[Axes]], None]", *, height_in: float, rows: int = 1, columns: int = 1
) -> Iterator[str]:
    """Yield a plot, as wide as the page, with its title and caption; ``draw`` gets ``rows`` times ``columns`` axes."""
    buffer = BytesIO()
    with drawing(buffer, rows=rows, columns=columns, size_in=(WIDTH_IN, height_in)) as axes:
        draw(axes)
    svg = buffer.getvalue().decode()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    # Nothing refers to the ids of groups, and two plots on a page would have the same.
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)
    svg = svg.replace("<svg ", f'<svg role="img" aria-label="{escape(title)}" ', 1)
    yield f"<h2>{escape(title)}</h2>"
    yield f"<figure>{svg}<figcaption>{escape(caption)}</figcaption></figure>"


def mark(text: str, good: bool) -> str:
    """Return a text in the colour for "passed" (``good``) or "failed"."""
    return f'<span class="{"passed" if good else "failed"}">{escape(text)}</span>'


def table(head: Sequence[str], rows: Iterable[Sequence[str]], numbers: Sequence[int] = ()) -> Iterator[str]:
    """Yield a table, whose cells are HTML already; ``numbers`` are the columns that hold numbers."""
    kinds = ["n" if place in numbers else "t" for place in range(len(head))]
    heads = (f'<th class="{kind}">{cell}</th>' for kind, cell in zip(kinds, head, strict=True))
    yield f"<table><thead><tr>{''.join(heads)}</tr></thead><tbody>"
    for row in rows:
        cells = (f'<td class="{kind}">{cell}</td>' for kind, cell in zip(kinds, row, strict=True))
        yield f"<tr>{''.join(cells)}</tr>"
    yield "</tbody></table>"
