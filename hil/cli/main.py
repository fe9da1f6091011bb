"""The ``hil`` command. Its commands are listed in ``commands.py``; each is imported when it is called.

Exit codes: 0 the run ended as expected, 1 an expectation failed, 2 bad input, 3 a failed link or device, or a law that
does not return, 130 interrupted.
"""

import errno
import gc
import sys
from typing import Annotated, TextIO, cast

import typer
from typer import Option

from hil import __version__
from hil.cli.commands import Commands
from hil.cli.output import WIDEST, drop_output, flush_output, say_on_stderr
from hil.core.errors import BadInputError, HilError
from hil.core.extensions import tracebacks_shown
from hil.core.printable import PrintableStream
from hil.core.strangers import refuse_code
from hil.core.subprocesses import one_thread_a_process

app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # rich's boxes take longer to import than everything else
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": WIDEST},
)


def _print_version(asked: bool) -> None:
    if asked:
        print(f"hil {__version__}")
        raise typer.Exit


@app.callback()
def hil(
    context: typer.Context,
    version: Annotated[
        bool, Option("--version", help="print the version and end", callback=_print_version, is_eager=True)
    ] = False,
    no_code: Annotated[bool, Option("--no-code", help="refuse laws in Python files and FMUs of others")] = False,
    show_traceback: Annotated[
        bool, Option("--traceback", help="print the whole traceback where a law or other code of yours fails")
    ] = False,
) -> None:
    """Test a Mecanum robot's controller against a plant FMU before the wheels touch the ground."""
    if no_code:
        refuse_code()
    if show_traceback:
        context.with_resource(tracebacks_shown())


_GC_THRESHOLD = 100_000
"""New objects before a garbage collection; Python's default of 700 would scan all modules again and again at start."""

_SHOWN = 40  # characters of a name that is too long


def main() -> None:
    """Entry point. A HilError is printed as one sentence on stderr, and gives the exit code."""
    gc.set_threshold(_GC_THRESHOLD)
    sys.stdout, sys.stderr = (cast("TextIO", PrintableStream(stream)) for stream in (sys.stdout, sys.stderr))
    one_thread_a_process()
    try:
        try:
            app(prog_name="hil", standalone_mode=True)
        finally:
            flush_output()
            gc.freeze()  # otherwise the interpreter's end scans all modules once more: 0.08 s after a run
    except HilError as error:
        say_on_stderr(f"hil: {error}")
        sys.exit(error.exit_code)
    except OSError as error:
        if error.errno == errno.ENOSPC:
            drop_output()
            sentence = "no space is left for the output; free some, or write it elsewhere"
        elif error.errno == errno.ENAMETOOLONG:  # each command has names, and all end here
            name = str(error.filename)
            sentence = f"{name[:_SHOWN]!r}...: a file's name of {len(name)} characters is too long; give a shorter one"
        else:
            raise
        say_on_stderr(f"hil: {sentence}")
        sys.exit(BadInputError.exit_code)


if __name__ == "__main__":
    main()
