"""The ``hil`` command. Its commands are listed in ``commands.py``; each is imported when it is called.

Exit codes: 0 the run ended as expected, 1 an expectation failed, 2 bad input, 3 a failed link or device, or a law that
does not return, 130 interrupted.
"""

import errno
import gc
import io
import os
import sys
from pathlib import Path
from typing import Annotated, TextIO, cast

import typer
from typer import Option

from hil import __version__
from hil.cli.commands import Commands
from hil.cli.output import WIDEST, drop_output, flush_output, say_on_stderr
from hil.core.errors import BadInputError, HilError
from hil.core.extensions import refuse_code, tracebacks_shown
from hil.core.interrupts import INTERRUPTED
from hil.core.printable import PrintableStream
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


_HELP = {
    errno.EFBIG: "raise the limit of the size of files (ulimit -f)",
    errno.EMFILE: "raise the limit of open files (ulimit -n)",
    errno.ENFILE: "end other programs: this system has too many open files",
    errno.ENOMEM: "end other programs, or raise the limit of memory (ulimit -v)",
    errno.EAGAIN: "end other programs, or raise the limit of processes (ulimit -u)",
    errno.EDQUOT: "make room in your quota",
    errno.EROFS: "choose another place, or make this one writable",
    errno.EACCES: "choose another place, or make this one accessible",
}
"""What helps against the limits of a machine, of which any command may hit one anywhere."""


def _open_standard_streams() -> None:
    """Open streams that the caller closed (``>&-``) to the null device: else the next opened file takes their place.

    Letters that an encoding lacks (LANG=C) are written as escapes.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            try:
                os.fstat(number)
            except OSError:
                os.open(os.devnull, os.O_RDWR)  # takes the lowest number, which is this one
            setattr(sys, name, Path(os.devnull).open("w" if number else "r", encoding="utf-8"))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def main() -> None:
    """Entry point. A HilError is printed as one sentence on stderr, and gives the exit code."""
    gc.set_threshold(_GC_THRESHOLD)
    _open_standard_streams()
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
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    except RecursionError:
        say_on_stderr("hil: a file or an option is nested too deeply to be read; give one with fewer levels")
        sys.exit(BadInputError.exit_code)
    except MemoryError:
        say_on_stderr("hil: there is too little memory; end other programs, or raise the limit of this one (ulimit -v)")
        sys.exit(BadInputError.exit_code)
    except OSError as error:
        if error.errno == errno.ENOSPC:
            drop_output()
            sentence = "no space is left for the output; free some, or write it elsewhere"
        elif error.errno == errno.ENAMETOOLONG:  # each command has names, and all end here
            name = str(error.filename)
            sentence = f"{name[:_SHOWN]!r}...: a file's name of {len(name)} characters is too long; give a shorter one"
        elif error.errno in _HELP:
            what = f"{error.filename}: " if error.filename else ""
            sentence = f"{what}{error.strerror}; {_HELP[error.errno]}"
        elif error.errno == errno.ENOENT and error.filename is None:  # os.getcwd, which names no file
            sentence = "the folder in which you are has been removed; go to another one"
        else:
            raise
        say_on_stderr(f"hil: {sentence}")
        sys.exit(BadInputError.exit_code)


if __name__ == "__main__":
    main()
