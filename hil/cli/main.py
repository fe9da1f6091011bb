"""The ``hil`` command. Its commands are listed in ``commands.py``; each is imported when it is called.

Exit codes: 0 the run ended as expected, 1 an expectation failed, 2 bad input, 3 a failed link or device, or a law that
does not return, 130 interrupted.
"""

import errno
import gc
import sys

import typer

from hil.cli.commands import Commands
from hil.cli.output import drop_output, flush_output
from hil.core.errors import BadInputError, HilError
from hil.core.subprocesses import one_thread_a_process

app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # rich's boxes take longer to import than everything else
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback()
def hil() -> None:
    """Test a Mecanum robot's controller against a plant FMU before the wheels touch the ground."""


_GC_THRESHOLD = 100_000
"""New objects before a garbage collection; Python's default of 700 would scan all modules again and again at start."""


def main() -> None:
    """Entry point. A HilError is printed as one sentence on stderr, and gives the exit code."""
    gc.set_threshold(_GC_THRESHOLD)
    one_thread_a_process()
    try:
        try:
            app(prog_name="hil", standalone_mode=True)
        finally:
            flush_output()
            gc.freeze()  # otherwise the interpreter's end scans all modules once more: 0.08 s after a run
    except HilError as error:
        print(f"hil: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
        drop_output()
        print("hil: no space is left for the output; free some, or write it elsewhere", file=sys.stderr)
        sys.exit(BadInputError.exit_code)


if __name__ == "__main__":
    main()
