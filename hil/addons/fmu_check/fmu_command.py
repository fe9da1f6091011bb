"""``hil fmu``: the plant's FMUs."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from hil.cli.commands import Group
from hil.cli.options import Json
from hil.cli.output import print_result, rows, slowly, table
from hil.core.errors import BadInputError

if TYPE_CHECKING:
    from hil.addons.fmu_check.check import CheckResult
    from hil.addons.fmu_check.info import FmuInfo, VariableInfo

app = typer.Typer(cls=Group, no_args_is_help=True, help="The plant: build, look at and check FMUs.")


@app.command("build")
def build(
    out: Annotated[Path | None, Option(metavar="DIR", help="by default the shipped place")] = None,
    all_platforms: Annotated[bool, Option("--all-platforms", help="for Linux, Windows and macOS; needs --out")] = False,
    mujoco: Annotated[bool, Option("--mujoco", help="the MuJoCo plant instead, for this machine")] = False,
) -> None:
    """Compile the Mecanum plant and package it as FMUs, one for FMI 2.0 and one for FMI 3.0. Needs a checkout."""
    from firmware_protocol.built import is_checkout, run_script
    from hil.plant.built import FMUS, MUJOCO
    from plant_fmu import path as shipped_path

    if all_platforms and mujoco:
        raise BadInputError("--mujoco is built for this machine only; leave out --all-platforms")
    if all_platforms and out is None:
        raise BadInputError("--all-platforms makes FMUs for other machines; name a folder for them with --out FOLDER")
    if not is_checkout():
        raise BadInputError("an installed package cannot build FMUs; run hil fmu build in a checkout of the sources")
    script = FMUS[MUJOCO if mujoco else shipped_path()].module
    arguments = ["--all-platforms"] if all_platforms else []
    if out is not None:
        arguments += ["--out", str(out.absolute() / MUJOCO.name if mujoco else out.absolute())]
    done = run_script(script, *arguments)
    if done.returncode != 0:
        raise BadInputError(f"the FMU was not built: {done.stderr.strip()}")
    print(done.stdout, end="")


FmuName = Annotated[str, Argument(metavar="FMU", help="a path, or the shipped name")]


@app.command("info")
def show_info(
    fmu: FmuName = "mecanum",
    names: Annotated[str, Argument(metavar="PATTERN", help="a variable, or several, as in 'wheel.*'")] = "*",
    as_json: Json = False,
) -> None:
    """Show an FMU's description of itself, and its variables with units. Runs none of its code."""
    from hil.addons.fmu_check.info import info
    from hil.plant import archive

    about = info(archive.locate(fmu, Path()), names)
    print_result(as_json, asdict(about), _info_lines(about))


@app.command("check")
def check_fmu(fmu: FmuName = "mecanum", as_json: Json = False) -> None:
    """Validate an FMU and run it through the FMI calling sequence; exit 1 when it violates the standard."""
    from hil.addons.fmu_check.check import check
    from hil.plant import archive

    path = archive.locate(fmu, Path())
    with slowly(f"checking {path.name}") as say:
        result = check(path, say=lambda part: say(f"checking {path.name}: {part}"))
    found = {"fmu": str(path), "passed": not result.violations, **asdict(result)}
    print_result(as_json, found, _check_lines(path, result))
    raise typer.Exit(1 if result.violations else 0)


def _info_lines(info: "FmuInfo") -> Iterator[str]:
    """Yield an FMU's description, and its variables as a table."""
    from hil.plant.child_output import one_line

    yield f"{info.path}{f' (shipped as {info.shipped})' if info.shipped else ''}"
    facts = [("model", info.model_name), *info.about.items(), ("FMI version", info.fmi_version)]
    for interface, identifier in info.interfaces.items():
        claims = ", ".join(info.capabilities[interface]) or "no optional capabilities"
        facts.append((interface, f"{identifier}: {claims}"))
    experiment = ", ".join(f"{name} {value}" for name, value in info.experiment.items())
    facts += [("platforms", ", ".join(info.platforms) or "none"), ("default experiment", experiment or "none")]
    facts += [("communication step", info.step), ("sha256", info.sha256)]
    yield from rows((name, one_line(value)) for name, value in facts)
    yield ""
    head = ("name", "causality", "variability", "type", "unit", "start", "range", "description")
    variables = [
        (v.name, v.causality, v.variability, _type(v), v.unit or "", v.start or "", _range(v), v.description or "")
        for v in info.variables
    ]
    yield from _table([head, *variables])


def _check_lines(fmu: Path, result: "CheckResult") -> Iterator[str]:
    """Yield the parts of a check as a table, then its findings, violations of the standard first."""
    from hil.addons.fmu_check import Kind
    from hil.plant.child_output import one_line

    parts = [("part", "outcome", "reason")]
    for part in result.parts:
        kinds = {finding.kind for finding in part.findings}
        found = next((kind for kind in Kind if kind in kinds), None)
        outcome = "fail" if found == Kind.VIOLATION else found or ("skip" if part.skipped else "pass")
        parts.append((part.name, outcome, part.skipped or ""))
    yield from _table(parts)
    for kind in Kind:
        yield from (one_line(f"{kind}: {finding}") for finding in result.texts(kind))
    counts = {kind: len(result.texts(kind)) for kind in Kind}
    violations = counts[Kind.VIOLATION]
    words = [f"{violations or 'no'} violation{'' if violations == 1 else 's'} of the standard"]
    if count := counts[Kind.NEED]:
        words.append(f"{count} thing{'' if count == 1 else 's'} that this importer needs otherwise")
    yield f"{fmu}: {', '.join(words)}"


def _table(texts: Sequence[Sequence[str]]) -> Iterator[str]:
    """Yield a table of an FMU's texts, which may hold line breaks."""
    from hil.plant.child_output import one_line

    return table([tuple(map(one_line, row)) for row in texts])


def _type(variable: "VariableInfo") -> str:
    size = ", ".join(map(str, variable.dimensions))
    return f"{variable.type}[{size}]" if size else variable.type


def _range(variable: "VariableInfo") -> str:
    if variable.items:
        return " | ".join(f"{value} {name}" for name, value in variable.items)
    low, high = variable.min, variable.max
    if low is None and high is None:
        return ""
    if high is None:
        return f"from {low}"
    return f"up to {high}" if low is None else f"{low} to {high}"
