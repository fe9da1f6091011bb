"""``hil identify``: drives that show what a robot is made of, and the fit to their recordings."""

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from hil.cli import options as o
from hil.cli.commands import Group
from hil.cli.output import end_in_order, next_command, print_result, rows, say, say_on_stderr, table, warn
from hil.core.errors import BadInputError, RunInterruptedError
from hil.core.extras import need
from hil.core.outputs import existing_files

if TYPE_CHECKING:
    from hil.identify.estimates import Estimate
    from hil.identify.fit import Result
    from hil.identify.recorded import Drive

SCHEMA, DRIVE_SCHEMA, FMU_SCHEMA = "hil.identify/1", "hil.identify.drive/1", "hil.identify.fmu/1"
"""Name and version of the JSON of each command; ``identify.schema.json`` in hil/identify describes it."""

app = typer.Typer(
    cls=Group,
    no_args_is_help=True,
    help="Drive your robot so that it shows what it is made of, and fit a plant to the recordings.",
)

_Recording = Path | None


@app.command("drive")
def drive(
    scenario: o.ScenarioName,
    out: Annotated[Path, Option(metavar="DIR", help="where the recordings go")] = Path("runs/identify"),
    step: Annotated[
        list[str] | None,
        Option(metavar="STEP", help="only this one: blocks, floor, squeeze or held_out; repeatable"),
    ] = None,
    room: Annotated[float, Option(metavar="M", help="side of the free square on the floor")] = 3.0,
    grip: Annotated[float, Option(metavar="NUMBER", help="what the floor surely has; rubber 0.5 and more")] = 0.5,
    robot: o.RobotFile = None,
    link: o.LinkUrl = None,
    mode: o.Mode = None,
    truth: o.TruthUrl = None,
    seed: Annotated[int, Option(metavar="N", help="of the drives' random phases", min=0)] = 1,
    yes: Annotated[bool, Option("--yes", help="do not wait for Enter before each drive")] = False,
    allow_motion: o.AllowMotion = False,
    force: o.Force = False,
    as_json: o.Json = False,
) -> None:
    """Drive on blocks, on the floor, squeeze the wheels, and drive once more for the fit to be judged by.

    Each drive is announced, and begins when Enter is pressed. The robot stays within the square of --room. It is a run
    of the scenario with another reference, so its limits hold, and Ctrl-C stops the robot.
    """
    from hil.core.outputs import check_free
    from hil.identify.drive import STEPS, Plan, perform, plan_step
    from hil.runtime.assembly import RunOptions

    end_in_order()
    existing = existing_files(force=force)
    plan = Plan(room_m=room, grip=grip, seed=seed)
    where = {"robot": robot, "link": link, "mode": mode}
    steps = [plan_step(name, scenario, plan, **where) for name in step or STEPS]
    files = {one.name: out / f"{one.name}.rrd" for one in steps}
    for file in files.values():
        check_free("recording", file, existing)
    if not yes and not sys.stdin.isatty():
        raise BadInputError("stdin is not a terminal; --yes begins each drive without waiting for Enter")
    out.mkdir(parents=True, exist_ok=True)
    done: dict[str, Any] = {}
    options = RunOptions(truth=truth, existing=existing, allow_motion=allow_motion, warn=warn, keep_signals=False)
    try:
        for one in steps:
            print(f"{one.name}, {one.scenario.loop.duration_s:g} s: {one.asks}", file=sys.stderr, flush=True)
            if not yes:
                print("Press Enter to begin, Ctrl-C to end: ", end="", file=sys.stderr, flush=True)
                if not sys.stdin.readline():
                    raise BadInputError("the input ended; this drive and those after it were not driven")
            result = perform(one, files[one.name], options)
            done[one.name] = str(files[one.name])
            if result.failure is not None:
                raise result.failure
            if not as_json:
                say(f"  recorded {files[one.name]}")
    except KeyboardInterrupt:
        raise RunInterruptedError("interrupted; the robot was told to stop") from None
    named = [
        word
        for name in ("blocks", "squeeze", "held_out")
        if name in files
        for word in (f"--{name.replace('_', '-')}", files[name])
    ]
    fitted = next_command("hil", "identify", "fit", files.get("floor", "RECORDING"), *named, "--mass-kg", "KG")
    print_result(as_json, {"schema": DRIVE_SCHEMA, "recordings": done}, ["Next:", f"  {fitted}"])


@app.command("fit")
def fit(
    recordings: Annotated[list[Path], Argument(metavar="RUN", help="drives on the floor")],
    blocks: Annotated[_Recording, Option(metavar="RUN", help="a drive on blocks")] = None,
    squeeze: Annotated[_Recording, Option(metavar="RUN", help="wheels turned against one another")] = None,
    held_out: Annotated[
        _Recording, Option(metavar="RUN", help="the drive to judge by; by default the last third of the first")
    ] = None,
    mass_kg: Annotated[float | None, Option(metavar="KG", help="the robot's weight on a scale", min=0.01)] = None,
    tape: Annotated[
        float | None, Option(metavar="M", help="distance from the first recording's start to its end", min=0.1)
    ] = None,
    tape_sigma: Annotated[
        float, Option(metavar="M", help="standard deviation of --tape, with that of the marks", min=1e-5)
    ] = 0.003,
    contact: Annotated[
        str, Option(metavar="rigid|both", help="rigid: no model with slip; both: the better one is taken")
    ] = "both",
    out: Annotated[Path, Option(metavar="DIR", help="robot.toml, plant.toml, fit.json and a picture")] = Path(
        "identified"
    ),
    pictures: o.PictureFormat = "png",
    force: o.Force = False,
    as_json: o.Json = False,
) -> None:
    """Fit a robot and its plant to recordings, with intervals, and judge them by a drive that the fit has not seen.

    First it says what these recordings can and cannot tell, and which measurement would settle the rest. The exit code
    is 1, and nothing is written, when the fitted plant predicts the held-out drive no better than what was believed.
    """
    from hil.identify.estimates import estimates
    from hil.identify.files import PICTURE, check_files, write_figures, write_files
    from hil.identify.fit import fit as fit_drives
    from hil.identify.kinematics import Tape
    from hil.identify.page import draw
    from hil.review.plots import check_format

    if contact not in ("rigid", "both"):
        raise BadInputError(f"--contact {contact}: expected rigid or both")
    if contact == "rigid" and squeeze is not None:
        raise BadInputError("--squeeze: a model without slip has no grip; leave out --contact rigid, or the squeeze")
    existing = existing_files(force=force)
    kind = check_format("--pictures", pictures)
    check_files(out, kind, existing)
    need("plots", "hil identify fit")
    floor, judged_by = _read(recordings, held_out)
    others = {name: _drive(path) for name, path in (("blocks", blocks), ("squeeze", squeeze)) if path is not None}
    contacts = ("rigid",) if contact == "rigid" else ("rigid", "slip")
    measured = None if tape is None else Tape(tape, tape_sigma)
    result = fit_drives(floor, judged_by, tape=measured, contacts=contacts, **others)
    found = estimates(result, mass_kg)
    figures = {"schema": SCHEMA, **_figures(result, found)}
    better = figures["passed"]
    made_from = [*floor, *others.values(), judged_by]
    if better:
        figures["files"] = [str(path) for path in write_files(out, result, found, made_from, existing)]
        draw(result, out / f"{PICTURE}.{kind}", existing)
        write_figures(out, figures, existing)
    print_result(as_json, figures, _lines(result, found, out if better else None))
    raise typer.Exit(0 if better else 1)


@app.command("fmu")
def fit_fmu(
    scenario: o.ScenarioName,
    recordings: Annotated[list[Path], Argument(metavar="RUN", help="drives of the robot")],
    parameter: Annotated[list[str], Option(metavar="NAME", help="of the FMU, to be fitted; repeatable")],
    held_out: Annotated[
        _Recording, Option(metavar="RUN", help="the drive to judge by; by default the last third of the first")
    ] = None,
    robot: o.RobotFile = None,
    sets: o.Sets = None,
    out: Annotated[Path, Option(metavar="FILE.toml", help="a scenario with the values, which extends this one")] = Path(
        "plant.toml"
    ),
    force: o.Force = False,
    as_json: o.Json = False,
) -> None:
    """Fit parameters of a scenario's FMU, whatever it is, by their names; the scenario maps it to the bridge's signals.

    The exit code is 1, and nothing is written, when it predicts the wheel speeds of the held-out drive no better.
    """
    from hil.core.outputs import check_free
    from hil.identify.files import write_mapped
    from hil.identify.mapped import fit_mapped
    from hil.scenario import load

    existing = existing_files(force=force)
    check_free("file", out, existing)
    base = load(scenario, set=sets or [], robot=robot)
    drives, judged_by = _read(recordings, held_out)
    found = fit_mapped(drives, judged_by, base, parameter)
    better = found.after_rad_s < found.before_rad_s
    if better:
        write_mapped(out, found, base, [*drives, judged_by], existing)
    figures = {
        "schema": FMU_SCHEMA,
        "passed": better,
        "estimates": [one._asdict() for one in found.estimates],
        "held_out": {"before_rms_rad_s": found.before_rad_s, "after_rms_rad_s": found.after_rad_s},
        "file": str(out) if better else None,
    }
    lines = [
        *table([_HEAD, *map(_row, found.estimates)]),
        "Held-out drive, error of the wheel speeds (rms):",
        *rows([("before", f"{found.before_rad_s:.3g} rad/s"), ("fitted", f"{found.after_rad_s:.3g} rad/s")]),
        f"Wrote {out}" if better else "The fit predicts no better than the scenario's values; nothing was written",
    ]
    print_result(as_json, figures, lines)
    raise typer.Exit(0 if better else 1)


def _read(recordings: "Sequence[Path]", held_out: Path | None) -> "tuple[list[Drive], Drive]":
    """Return the drives to fit, and the one to judge by: the last third of the first where none is given."""
    from hil.identify.recorded import split

    drives = [_drive(path) for path in recordings]
    if held_out is not None:
        return drives, _drive(held_out)
    first, judged_by = split(drives[0])
    return [first, *drives[1:]], judged_by


def _drive(recording: Path) -> "Drive":
    """Read a drive, and say how much of it is not used."""
    from hil.identify.recorded import read_drive

    drive = read_drive(recording)
    if drive.unused_s > drive.period_s:
        whole_s = drive.time_s[-1] - drive.time_s[0] + drive.unused_s
        say_on_stderr(
            f"hil: note: {recording}: {drive.unused_s:.3g} s of {whole_s:.3g} s are not used, only its longest stretch "
            "without a gap in the feedback"
        )
    return drive


_HEAD = ("value", "", "95 % from", "to", "", "")


def _row(one: "Estimate") -> tuple[str, ...]:
    interval = ("", "") if one.low == one.high else (f"{one.low:.5g}", f"{one.high:.5g}")
    return one.name, f"{one.value:.5g}", *interval, one.status, one.why


def _figures(result: "Result", found: "Sequence[Estimate]") -> dict[str, Any]:
    kinematics = result.kinematics
    return {
        "passed": result.chosen.held_out.rms_m < result.before.rms_m,
        "unknown": [one.sentence for one in result.outlook.unknown],
        "notes": list(result.notes),
        "contact": result.chosen.contact,
        "estimates": [one._asdict() for one in found],
        "sideways": {"scale": kinematics.sideways, "sigma": kinematics.sideways_sigma},
        "gyro_bias_rad_s": kinematics.gyro_bias_rad_s,
        "fix_delay_s": kinematics.delay_s,
        "held_out": {
            "against": result.before.against,
            "before_rms_m": result.before.rms_m,
            **{f"{model.contact}_rms_m": model.held_out.rms_m for model in result.models},
        },
    }


def _lines(result: "Result", found: "Sequence[Estimate]", written: Path | None) -> Iterator[str]:
    """Yield what could be told, the values, the verdict and where it is written."""
    from hil.identify.robust import Z_95

    if result.outlook.unknown:
        yield "What these recordings cannot tell well:"
        yield from (f"  {one.sentence}" for one in result.outlook.unknown)
    yield from result.notes
    yield ""
    yield from table([_HEAD, *map(_row, found)])
    kinematics, before = result.kinematics, result.before
    errors = [("before the fit", f"{1e3 * before.rms_m:.3g} mm")]
    errors += [(f"fitted, {model.contact}", f"{1e3 * model.held_out.rms_m:.3g} mm") for model in result.models]
    yield ""
    if kinematics.sideways_sigma == kinematics.sideways_sigma:
        sideways, half = kinematics.sideways, Z_95 * kinematics.sideways_sigma
        yield f"Scale of sideways motion, for odometry: {sideways:.4f} ± {half:.4f}"
    yield f"Held-out drive, error of the position after a second against {before.against} (rms):"
    yield from rows(errors)
    if written is None:
        yield "The fit predicts no better than what was believed; nothing was written"
    else:
        yield f"Taken: {result.chosen.contact}. Wrote {written}: robot.toml for --robot, plant.toml to extend"
