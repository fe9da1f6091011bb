"""The cost of a start: the imported modules, which are the same on every machine."""

import subprocess
import sys

import pytest

from hil.core.subprocesses import child_environment
from tests.support.processes import environment

_HELP = "from hil.cli.main import app\ntry: app(['--help'])\nexcept SystemExit: pass"
# Not hil probe, whose classes are those of the drivers.
_COMMANDS = """
from hil.cli.commands import shipped, shipped_command
for name in shipped():
    if name != "probe":
        shipped_command(name)
"""
_HEAVY = {"can", "cffi", "fmpy", "matplotlib", "pandas", "pyarrow", "rerun", "rich", "scipy"}


def _imported(program: str) -> set[str]:
    code = f"import sys\n{program}\nprint(*{{name.partition('.')[0] for name in sys.modules}})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment())
    return set(done.stdout.splitlines()[-1].split())


@pytest.mark.parametrize(
    ("program", "heavy"),
    [
        (_HELP, _HEAVY | {"numpy", "pydantic"}),
        (_COMMANDS, (_HEAVY - {"rich"}) | {"pydantic"}),
        ("import hil", _HEAVY | {"numpy", "pydantic", "typer"}),
        ("import hil.record.recording", _HEAVY | {"numpy", "pydantic", "typer"}),
    ],
    ids=["hil --help", "help of a command", "import hil", "what starts a recorder"],
)
def test_nothing_heavy_is_imported_before_it_is_needed(program: str, heavy: set[str]) -> None:
    assert not _imported(program) & heavy


def test_the_libraries_are_loaded_without_a_parser_of_c() -> None:
    program = "from firmware_protocol.extension import library; from hil.plant.shim import load; library(), load()"
    assert not _imported(program) & {"cffi", "pycparser"}


def test_a_bare_run_imports_few_lines_of_ours() -> None:
    """Whoever takes over has to know these; a package that only some runs need is imported when it is used."""
    count = """
import hil
hil.run("paper_circle", set={"loop.duration_s": 0.2, "expect": []})
files = [getattr(module, "__file__", None) or "" for name, module in sys.modules.items()
         if name.partition(".")[0] in ("hil", "plant_fmu", "firmware_protocol")]
print(sum(len(open(file).readlines()) for file in files if file.endswith(".py")))
"""
    done = subprocess.run([sys.executable, "-c", f"import sys{count}"], capture_output=True, text=True, check=True)
    assert int(done.stdout) <= 20_000


def test_a_run_imports_no_viewer_no_plots_and_no_tables() -> None:
    assert not _imported("import hil.runtime.assembly") & {"fmpy", "matplotlib", "pandas", "pyarrow", "rerun", "scipy"}


def test_a_run_on_this_machine_needs_no_locks_no_parser_of_c_and_no_masked_arrays() -> None:
    """``numpy.ma`` is imported by NumPy's own medians and percentiles."""
    run = "import hil\nhil.run('paper_circle', set={'loop.duration_s': 6.0})"
    assert not _imported(f"{run}\nassert 'numpy.ma' not in sys.modules") & {
        "can",
        "cffi",
        "filelock",
        "rich",
        "serial",
    }


def test_a_recorder_imports_no_more_than_rerun_needs() -> None:
    recorder = (
        "from hil.record.recorder import _import_rerun\n_import_rerun(['hil.addons.report.run_drawing:RunDrawing'])"
    )
    assert "rerun" in (imported := _imported(recorder))
    assert not imported & {"cobs", "email", "http", "matplotlib", "pandas", "pydantic", "ssl", "typer"}


def test_numpy_starts_no_threads_unless_the_user_wants_some(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    assert child_environment()["OPENBLAS_NUM_THREADS"] == "1"
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "4")
    assert child_environment()["OPENBLAS_NUM_THREADS"] == "4"
