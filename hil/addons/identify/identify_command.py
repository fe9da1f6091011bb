"""``hil commission``; ``hil identify``: drives for identification, and the fit to their recordings."""

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
from hil.core.outputs import existing_files

if TYPE_CHECKING:
    from hil.addons.identify.drives import Drive
    from hil.addons.identify.estimates import Estimate
    from hil.addons.identify.fit import Result

SCHEMA, DRIVE_SCHEMA = "hil.identify/1", "hil.identify.drive/1"
"""Name and version of the JSON of each command; ``identify.schema.json`` in hil/addons/identify describes it."""

app = typer.Typer(
    cls=Group,
    no_args_is_help=True,
    help="Drive your robot so that it shows what it is made of, and fit a plant to the recordings.",
)

_Recording = Path | None


def commission(
    robot: Annotated[Path, Argument(metavar="ROBOT", help="the robot's own file, as hil init or hil probe writes it")],
    link: o.LinkUrl = None,
    anew: Annotated[bool, Option("--anew", help="begin again, also with a robot that is commissioned")] = False,
    sets: o.Sets = None,
    as_json: o.Json = False,
) -> None:
    """Find out, step by step, how a robot is wired, on blocks and on the floor, and write it into its file.

    Every step is announced, small, and confirmed; Ctrl-C switches the drives off at any time, and the same command goes
    on there. The exit code is 1 where a step has failed or wires have to be changed. A virtual robot in this process
    (link memory:) answers for itself.
    """
    from hil.addons.identify.commission.commissioning import commission as run

    end_in_order()
    if not robot.is_file():
        raise BadInputError(
            f"{robot}: there is no such file; hil init writes one, or hil probe for motors of other makers"
        )
    hear = (lambda _: None) if as_json else say
    try:
        done = run(robot, sets=sets or [], link=link, anew=anew, say=hear)
    except KeyboardInterrupt:
        raise RunInterruptedError(
            "interrupted; the drives were told to switch off; go on with the same command"
        ) from None
    kept = done.table
    found = {"state": kept.state, "steps": kept.steps, "todo": kept.todo, "found": done.values}
    lines = [f"{robot}: state {kept.state}", *(f"to do: {one}" for one in kept.todo)]
    if kept.todo:
        lines.append("then commission the robot again, with the same command")
    if "firmware.counts_per_revolution" in done.values or "robot.wheel_radius_m" in done.values:
        lines.append("our firmware holds some of these values too: hil params LINK NAME=VALUE --store")
    print_result(as_json, found, lines)
    raise typer.Exit(0 if kept.state == "done" else 1)


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
    from hil.addons.identify.excitation import STEPS, Plan, perform, plan_step
    from hil.core.outputs import check_free
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
    named: list[str | Path] = []
    for name in (name for name in files if name != "floor"):
        named += [f"--{name.replace('_', '-')}", files[name]]
    fitted = next_command("hil", "identify", "fit", files.get("floor", "RECORDING"), *named, "--mass-kg", "KG")
    print_result(as_json, {"schema": DRIVE_SCHEMA, "recordings": done}, ["Next:", f"  {fitted}"])


@app.command("fit")
def fit(
    recording: Annotated[Path, Argument(metavar="RUN", help="a drive on the floor")],
    held_out: Annotated[Path, Option(metavar="RUN", help="a drive that is not fitted, to judge by")],
    blocks: Annotated[_Recording, Option(metavar="RUN", help="a drive on blocks")] = None,
    squeeze: Annotated[_Recording, Option(metavar="RUN", help="wheels turned against one another")] = None,
    mass_kg: Annotated[float | None, Option(metavar="KG", help="the robot's weight on a scale", min=0.01)] = None,
    out: Annotated[Path, Option(metavar="DIR", help="robot.toml, plant.toml and fit.json")] = Path("identified"),
    force: o.Force = False,
    as_json: o.Json = False,
) -> None:
    """Fit a robot and its plant to recordings, with intervals, and judge them by a drive that the fit has not seen.

    First it says what these recordings can and cannot tell, and which measurement would settle the rest. The exit code
    is 1, and nothing is written, when the fitted plant predicts the held-out drive no better than what was believed.
    """
    from hil.addons.identify.estimates import estimates
    from hil.addons.identify.fit import fit as fit_drives
    from hil.addons.identify.written_files import check_files, write_figures, write_files

    existing = existing_files(force=force)
    check_files(out, existing)
    floor, judged_by = _drive(recording), _drive(held_out)
    on_blocks, squeezed = (None if path is None else _drive(path) for path in (blocks, squeeze))
    result = fit_drives(floor, judged_by, blocks=on_blocks, squeeze=squeezed)
    found = estimates(result, mass_kg)
    figures = {"schema": SCHEMA, **_figures(result, found)}
    better = figures["passed"]
    made_from = [one for one in (floor, on_blocks, squeezed, judged_by) if one is not None]
    if better:
        figures["files"] = [str(path) for path in write_files(out, result, found, made_from, existing)]
        write_figures(out, figures, existing)
    print_result(as_json, figures, _lines(result, found, out if better else None))
    raise typer.Exit(0 if better else 1)


def _drive(recording: Path) -> "Drive":
    """Read a drive, and say how much of it is not used."""
    from hil.addons.identify.drives import read_drive

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
        "unknown": [one.sentence for one in result.unknown],
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
    """Yield the unknown parameters, the values, the errors on the held-out drive and the written files."""
    from hil.addons.identify.robust_statistics import Z_95

    if result.unknown:
        yield "What these recordings cannot tell well:"
        yield from (f"  {one.sentence}" for one in result.unknown)
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
