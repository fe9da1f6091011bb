"""``hil fmu``: the plant's FMUs."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from hil.cli.group import Commands
from hil.cli.options import Json, print_json
from hil.core.errors import BadInputError

app = typer.Typer(cls=Commands, no_args_is_help=True, help="The plant: build, look at and check FMUs.")


@app.command("build")
def build(
    out: Annotated[Path | None, typer.Option(metavar="FOLDER", help="by default the shipped place")] = None,
    all_platforms: Annotated[
        bool, typer.Option("--all-platforms", help="compile for Linux, Windows and macOS with zig; needs --out")
    ] = False,
    mujoco: Annotated[bool, typer.Option("--mujoco", help="the MuJoCo plant instead, for this machine")] = False,
) -> None:
    """Compile the Mecanum plant and package it as FMUs, one for FMI 2.0 and one for FMI 3.0. Needs a checkout."""
    from firmware_protocol.built import is_checkout, run_script
    from hil.plant.built import FMUS, MUJOCO
    from plant_fmu import path as shipped_path

    if all_platforms and mujoco:
        raise BadInputError("--mujoco is built for this machine only; leave out --all-platforms")
    if all_platforms and out is None:
        raise BadInputError("--all-platforms makes FMUs to give away; say where to with --out FOLDER")
    if not is_checkout():
        raise BadInputError(
            "an installed package has no scripts that build FMUs; run hil fmu build in a checkout of the sources"
        )
    script = FMUS[MUJOCO if mujoco else shipped_path()].module
    arguments = ["--all-platforms"] if all_platforms else []
    if out is not None:
        arguments += ["--out", str(out.absolute() / MUJOCO.name if mujoco else out.absolute())]
    done = run_script(script, *arguments)
    if done.returncode != 0:
        raise BadInputError(f"the FMU was not built: {done.stderr.strip()}")
    print(done.stdout, end="")


FmuName = Annotated[str, typer.Argument(metavar="FMU", help="a path, or the shipped name")]


@app.command("info")
def show_info(
    fmu: FmuName = "mecanum",
    names: Annotated[
        str, typer.Argument(metavar="[PATTERN]", help="only variables with such names, for example 'wheel.*'")
    ] = "*",
    as_json: Json = False,
) -> None:
    """Show what an FMU says of itself, and its variables with units. Runs nothing of it."""
    from hil.cli import report
    from hil.plant import archive
    from hil.plant.info import info

    about = info(archive.locate(fmu, Path()), names)
    if as_json:
        print_json(asdict(about))
    else:
        report.print_fmu(about)


@app.command("check")
def check_fmu(fmu: FmuName = "mecanum", as_json: Json = False) -> None:
    """Validate an FMU and run it through the FMI calling sequence; exit 1 when it violates the standard."""
    from hil.cli import report
    from hil.plant import archive
    from hil.plant.tools import check

    path = archive.locate(fmu, Path())
    result = check(path)
    if as_json:
        print_json({"fmu": str(path), "passed": not result.violations, **asdict(result)})
    else:
        report.print_check(path, result)
    raise typer.Exit(1 if result.violations else 0)
