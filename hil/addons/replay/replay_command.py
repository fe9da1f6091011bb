"""``hil replay``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from hil.cli.options import LAW, LAW_HELP, Force, Json, Sets
from hil.cli.output import print_result, table
from hil.core.errors import BadInputError

if TYPE_CHECKING:
    from hil.record.reader import RecordedRun


def replay(
    recording: Annotated[Path, Argument(metavar="RUN", help="recording of a run")],
    law: Annotated[str | None, Option(metavar=LAW, help=f"only another law, open loop: {LAW_HELP}")] = None,
    scenario: Annotated[
        Path | None, Option(metavar="FILE", help="with this scenario in place of the recorded one")
    ] = None,
    sets: Sets = None,
    tolerance: Annotated[
        list[str] | None, Option(metavar="SIGNAL=VALUE", help="what may differ, as in pose.*=1e-6; repeatable")
    ] = None,
    record: Annotated[Path | None, Option(metavar="FILE", help="record the replay, .rrd or .mcap")] = None,
    bisect: Annotated[
        str | None, Option(metavar="GOOD..BAD", help="name the first of these commits that differs")
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Repeat a recorded run with the controller as it is now, and say what differs first; exit 1 if anything does."""
    from hil.record.reader import read

    if law is not None:
        if scenario is not None or sets or tolerance or record is not None or bisect is not None:
            raise BadInputError("--law replays a law alone; give no other option")
        _replay_law(read(recording), law, as_json=as_json)
        return
    tolerances = _tolerances(tolerance or [])
    if bisect is not None:
        if record is not None:
            raise BadInputError("--bisect records no replay; leave --record out")
        options = [] if scenario is None else ["--scenario", str(scenario)]
        options += [word for text in tolerance or () for word in ("--tolerance", text)]
        options += [word for text in sets or () for word in ("--set", text)]
        _print_culprit(bisect, recording, options, as_json=as_json)
        return
    from hil.addons.replay import replay as whole
    from hil.scenario import load

    run = read(recording, with_journal=True)
    if sets and scenario is None:
        run = whole.changed(run, sets)
    found = whole.replay(
        run,
        scenario=None if scenario is None else load(scenario, set=sets or []),
        tolerances=tolerances,
        record=record,
        force=force,
    )
    print_result(as_json, whole.as_json(run, found), whole.lines(run, found))
    if not found.is_equal:
        raise typer.Exit(1)


def _print_culprit(span: str, recording: Path, options: list[str], *, as_json: bool) -> None:
    from hil.addons.replay.bisect import bisect

    commit, subject, found = bisect(span, recording, options)
    lines = [f"{commit[:12]} {subject}: it is the first that differs, {found['part']} first"]
    if found["frames"]["first"] is not None:
        lines.append(f"first frame: {found['frames']['first']['text']}")
    if found["signals"]:
        one = found["signals"][0]
        values = f"{one['now']:.9g} where {one['recorded']:.9g} was recorded"
        lines.append(f"first signal: {one['signal']} at t = {one['t_s']:.3f} s: {values}")
    print_result(as_json, {"commit": commit, "subject": subject, "replay": found}, lines)


def _tolerances(texts: list[str]) -> dict[str, float]:
    found = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            found[name] = float(value)
        except ValueError:
            found[name] = -1.0
        if not name or not found[name] >= 0.0:
            raise BadInputError(
                f"--tolerance {text}: expected SIGNAL=VALUE with a value of 0 or more, as in pose.*=1e-6"
            )
    return found


def _replay_law(run: "RecordedRun", law: str, *, as_json: bool) -> None:
    from hil.addons.replay import law_replay as replayer

    found = replayer.replay(run, law)
    ticks = len(run.signals["loop.t_s"])
    figures = {
        "open_loop": True,
        "label": replayer.LABEL,
        "recording": str(run.path),
        "law": found.law,
        "gains": dict(found.gains),
        "recorded_law": found.recorded_law,
        "ticks": ticks,
        "asked": found.asked,
        "commands_refused": found.commands_refused,
        "difference": {name: one._asdict() for name, one in found.differences.items()},
    }
    gains = "".join(f", {name} = {value}" for name, value in found.gains.items())
    head = ("open loop: replayed minus recorded", "rms", "max", "at t [s]", "recorded rms")
    rows = [
        (name, f"{one.rms:.4g}", f"{one.max:.4g}", f"{one.max_s:.3f}", f"{one.recorded_rms:.4g}")
        for name, one in found.differences.items()
    ]
    lines = [
        f"{found.law}{gains} on {run.path}, where {found.recorded_law} was in command",
        replayer.LABEL,
        f"{found.asked} of {ticks} ticks have a command of the law, {found.commands_refused} of them not finite",
        "",
        *table([head, *rows]),
    ]
    print_result(as_json, figures, lines)
