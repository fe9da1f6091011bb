"""``hil campaign``."""

import os
import sys
from collections import Counter
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from hil.cli.commands import Group
from hil.cli.options import AllowMotion, Force, Jobs, Json
from hil.cli.output import RunsProgress, duration_words, end_in_order, next_command, print_result
from hil.core.errors import BadInputError, RunInterruptedError, nearest
from hil.core.extras import need
from hil.core.subprocesses import on_signals

if TYPE_CHECKING:
    from hil.batch.campaign.campaign import Campaign, Place


class FileFirst(Group):
    """A group whose first command is called when the first argument is not a command's name."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]
        """Insert the name of the first command if none is given."""
        if args and args[0] not in self.commands and args[0] not in ctx.help_option_names:
            args = [next(iter(self.commands)), *args]
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=FileFirst,
    no_args_is_help=True,
    subcommand_metavar="PLAN.toml [OPTIONS] | report DIR [OPTIONS]",
    help="Run a scenario thousands of times, over axes, laws, faults and seeds, and judge it on one page.",
)


@app.command("run")
def run(
    plan: Annotated[Path, Argument(metavar="PLAN.toml", help="what is run, see CAMPAIGNS.md")],
    out: Annotated[Path | None, Option(metavar="DIR", help="results, continued if begun; by default runs/PLAN")] = None,
    dry_run: Annotated[bool, Option("--dry-run", help="say how many runs and about how long")] = False,
    jobs: Jobs = None,
    scheduler: Annotated[
        str | None, Option(metavar="URL", help="of Dask: tls://HOST:PORT, or tcp://127.0.0.1:PORT on this machine")
    ] = None,
    limit_s: Annotated[float | None, Option("--limit", metavar="S", help="a longer run ends as hung", min=1)] = None,
    memory_mb: Annotated[float | None, Option("--memory", metavar="MB", help="limit of a run", min=100)] = None,
    redo: Annotated[
        str | None, Option(metavar="OUTCOMES", help="do the runs with these outcomes again, as in lost,refused")
    ] = None,
    allow_motion: AllowMotion = False,
    as_json: Json = False,
) -> None:
    """Do the runs of a campaign that are not done yet; exit 1 when one did not pass."""
    end_in_order()
    if scheduler is not None and jobs is not None:
        raise BadInputError(f"--jobs {jobs}: an existing cluster has its own; leave it out with --scheduler")
    try:
        from hil.batch.campaign.campaign import Campaign, Place

        outcomes = _outcomes(redo)
        if scheduler is not None:
            need("campaign", "--scheduler")
            from hil.batch.dask_pool import check_address

            check_address(scheduler)
        campaign = Campaign(plan, allow_motion=allow_motion)
        folder = out if out is not None else Path("runs") / campaign.plan.file.name
        # The number of workers of an existing cluster is not known here: estimate for one worker.
        is_one = scheduler is not None or campaign.in_real_time or campaign.on_bench
        count = jobs or (1 if is_one else os.cpu_count() or 1)
        if campaign.on_bench and count > 1:
            raise BadInputError(
                f"--jobs {count}: there is one bench behind the link or the pose fixes; it takes one run at a time"
            )
        if dry_run:
            _print_estimate(campaign, folder, count, outcomes, as_json=as_json)
            return
    except KeyboardInterrupt:
        raise RunInterruptedError("interrupted; no run has begun") from None
    limit_s = limit_s or 120.0 + 2.0 * campaign.longest_s
    _perform(campaign, folder, Place(scheduler, count, limit_s, memory_mb), outcomes, as_json=as_json)


@app.command("report")
def report(
    folder: Annotated[Path, Argument(metavar="DIR", help="the results of a campaign")],
    html: Annotated[Path | None, Option(metavar="FILE.html", help="the page; by default DIR/report.html")] = None,
    pictures: Annotated[
        str | None, Option(metavar="png|svg|pdf", help="write each picture as a file beside the page too")
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Write one page about a campaign: distributions, effects, pass rates, law against law, the worst runs."""
    from hil.batch.campaign.judged import judge
    from hil.batch.campaign.page import write_page, write_pictures
    from hil.core.outputs import check_free, existing_files
    from hil.review.plots import check_format

    kind = None if pictures is None else check_format("--pictures", pictures)
    existing = existing_files(force=force)
    path = html if html is not None else folder / "report.html"
    check_free("page", path, existing)
    need("plots", "the page of a campaign")
    judged = judge(folder)
    write_page(path, judged, existing)
    files = [] if kind is None else [str(file) for file in write_pictures(path, judged, kind, existing)]
    found = {"html": str(path), "pictures": files, **judged.plain()}
    print_result(as_json, found, [*judged.sentences(), str(path), *files])


def _outcomes(redo: str | None) -> frozenset[str]:
    """Return the outcomes of ``--redo``."""
    from hil.batch.job import STATUSES

    names = [] if redo is None else [name.strip() for name in redo.split(",")]
    if wrong := [name for name in names if name not in STATUSES]:
        raise BadInputError(
            f"--redo {redo}: {wrong[0]!r} is not an outcome{nearest(wrong[0], STATUSES)}; give some of "
            f"{', '.join(STATUSES)}, with commas between them"
        )
    return frozenset(names)


def _perform(campaign: "Campaign", folder: Path, place: "Place", redo: frozenset[str], *, as_json: bool) -> None:
    stop = _Stop()
    total = len(campaign.runs)
    outcomes: Counter[str] = Counter()
    troubles: set[str] = set()
    progress = RunsProgress() if sys.stderr.isatty() and not as_json else None

    def show(trouble: str | None = None) -> None:
        done = outcomes.total()
        if progress is not None:
            progress(done, total, trouble, done - outcomes["passed"])
        elif trouble is not None and trouble not in troubles:
            troubles.add(trouble)
            print(f"hil: {trouble}", file=sys.stderr, flush=True)

    for rows in campaign.perform(folder, place, show, stop.is_requested, redo):
        outcomes.update(row["outcome"] for row in rows)
        show()
    if progress is not None:
        progress.end()
    done = outcomes.total()
    if stop.is_requested() and (done < total or campaign.records_worst):
        raise RunInterruptedError(
            f"interrupted; {done} of {total} runs are done and saved in {folder}; run the same command to continue"
        )
    passed = outcomes["passed"] == total
    counts = ", ".join(f"{count} {outcome}" for outcome, count in outcomes.most_common())
    found = {"passed": passed, "folder": str(folder), "runs": total, "outcomes": dict(outcomes)}
    print_result(as_json, found, [f"{total} runs: {counts}", next_command("hil", "campaign", "report", folder)])
    raise typer.Exit(0 if passed else 1)


class _Stop:
    """Ctrl-C, SIGTERM and SIGHUP: the first signal ends the campaign in order, the second one at once."""

    def __init__(self) -> None:
        self._count = 0
        on_signals(self._on_signal, "SIGINT", "SIGTERM", "SIGHUP")

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        self._count += 1
        if self._count > 1:
            raise RunInterruptedError("interrupted twice; what is written is kept; run the same command to continue")

    def is_requested(self) -> bool:
        """Whether the campaign should end."""
        return self._count > 0


def _print_estimate(campaign: "Campaign", folder: Path, workers: int, redo: frozenset[str], *, as_json: bool) -> None:
    left = campaign.left(folder, redo)
    run_s, total_s = campaign.estimate_s(left, workers)
    runs = len(campaign.runs)
    done = f", {runs - left} of them done" if left < runs else ""
    by = "1 worker" if workers == 1 else f"{workers} workers"
    text = f"{runs} runs{done}; about {duration_words(total_s)} with {by}, {run_s:.2g} s a run"
    found = {"runs": runs, "left": left, "workers": workers, "run_s": run_s, "total_s": total_s}
    print_result(as_json, found, [text])
