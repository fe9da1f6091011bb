"""What a batch of runs gave, shown by every command in one way: on the terminal, as JSON, as one page, as pictures.

A plan gives ``Results``; its tables and plots are those of the terminal, of the HTML page and of the picture files.
"""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from html import escape
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from typer import Option

from hil.cli.output import print_result
from hil.cli.output import table as columns_of_text
from hil.core.errors import BadInputError
from hil.core.extras import need
from hil.core.outputs import Existing, check_free, existing_files, write_whole
from hil.pages import html_page
from hil.pages.plots import check_format, drawing
from hil.record.files import check_output_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Html = Annotated[Path | None, Option(metavar="FILE.html", help="a page with plots, in one file")]
Pictures = Annotated[str | None, Option(metavar="png|svg|pdf", help="write each picture as a file beside the page too")]


class Table(NamedTuple):
    """A table of results: cells are text, the first row is the head; ``notes`` stand below, ``about`` above it.

    The columns in ``numbers`` hold numbers.
    """

    title: str
    rows: Sequence[Sequence[str]]
    notes: Sequence[str] = ()
    about: str = ""
    numbers: Sequence[int] = ()


class Plot(NamedTuple):
    """A plot: ``draw`` gets ``rows`` times ``columns`` axes; ``name`` is that of its file, without the ending."""

    name: str
    draw: Callable[["list[Axes]"], None]
    rows: int = 1
    columns: int = 1
    size_in: tuple[float, float] = (6.4, 4.0)
    title: str = ""
    caption: str = ""


class Results(NamedTuple):
    """What a batch gave.

    Attributes:
        title: of the page.
        passed: whether all is as it should be; otherwise the exit code is 1.
        verdict: one line on whether it passed. about: further lines.
        tables, plots: what is shown. plain: the whole result as values for ``--json``.
    """

    title: str
    passed: bool
    verdict: str
    about: Sequence[str]
    tables: Sequence[Table]
    plots: Sequence[Plot]
    plain: Mapping[str, Any]


class Page(NamedTuple):
    """Where a page goes (None: no page), the format of pictures next to it, and whether existing files are replaced."""

    file: Path | None
    kind: str | None
    existing: Existing

    @classmethod
    def of(cls, file: Path | None, pictures: str | None, *, force: bool) -> "Page":
        """Return the page that options ask for. Raises BadInputError when it cannot be written."""
        kind = None if pictures is None else check_format("--pictures", pictures)
        existing = existing_files(force=force)
        if file is not None:
            check_free("page", file, existing)
            check_output_path("page", file, existing)
            need("plots", "--html")
        elif kind is not None:
            raise BadInputError(f"--pictures {kind}: they stand beside the page; give --html FILE.html too")
        return cls(file, kind, existing)

    def picture(self, plot: Plot) -> Path:
        """Return the file of a plot beside the page."""
        assert self.file is not None
        return self.file.with_name(f"{plot.name}.{self.kind}")


def finish(results: Results, page: Page, *, as_json: bool, files: Mapping[Path, str] = MappingProxyType({})) -> None:
    """Print results, then write their page, its pictures, and further ``files`` with these texts.

    They are printed before files are written, because runs take long and a disk may be full. If a file cannot be
    written, the others still are; then raises BadInputError for the first.
    """
    print_result(as_json, results.plain, as_text(results))
    sys.stdout.flush()
    errors: list[BadInputError] = []

    def write(make: Callable[[], None]) -> None:
        try:
            make()
        except BadInputError as error:
            errors.append(error)

    for file, text in files.items():
        write(partial(write_whole, file, text.encode(), existing=page.existing))
    if page.file is not None:
        write(partial(html_page.write_document, page.file, as_html(results), page.existing))
        for plot in results.plots if page.kind is not None else ():
            write(partial(_write_plot, plot, page.picture(plot), page.existing))
    if errors:
        raise errors[0]


def as_text(results: Results) -> Iterator[str]:
    """Yield results as lines for the terminal."""
    for table in results.tables:
        yield table.title
        yield from columns_of_text(table.rows)
        yield from (f"  {note}" for note in table.notes)
        yield ""
    yield from (results.verdict, *results.about)


def as_html(results: Results) -> str:
    """Return results as an HTML page."""
    html = [f'<p class="verdict {"passed" if results.passed else "failed"}">{escape(results.verdict)}</p>']
    html += [f'<p class="about">{escape(sentence)}</p>' for sentence in results.about if sentence]
    for table in results.tables:
        html.append(f"<h2>{escape(table.title)}</h2>")
        if table.about:
            html.append(f'<p class="about">{escape(table.about, quote=False)}</p>')
        head, *rows = ([escape(cell) for cell in row] for row in table.rows)
        html += html_page.table(head, rows, table.numbers)
        html += [f'<p class="note">{escape(note)}</p>' for note in table.notes]
    for one in results.plots:
        html += html_page.figure(
            one.title or one.name,
            one.caption,
            one.draw,
            height_in=one.size_in[1] * html_page.WIDTH_IN / one.size_in[0],
            rows=one.rows,
            columns=one.columns,
        )
    return html_page.document(results.title, html)


def as_markdown(one: Table, level: str = "##") -> Iterator[str]:
    """Yield the lines of a table for a page in Markdown."""
    yield from ("", f"{level} {one.title}", "", markdown_table(one.rows).rstrip())
    if one.notes:
        yield from ("", *(f"- {note}" for note in one.notes))


def markdown_table(rows: Sequence[Sequence[str]]) -> str:
    """Return rows, the first of which is the head, as a table for a page in Markdown."""
    lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |\n" for row in rows]
    return "".join([lines[0], "|---" * len(rows[0]) + "|\n", *lines[1:]])


def _write_plot(one: Plot, file: Path, existing: Existing) -> None:
    with drawing(file, rows=one.rows, columns=one.columns, size_in=one.size_in, existing=existing) as axes:
        one.draw(axes)
