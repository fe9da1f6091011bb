"""``hil campaign``."""

import os
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from hil.addons.batch.results_page import Html, Page, Pictures, finish
from hil.cli.commands import Group
from hil.cli.options import AllowMotion, Force, Jobs, Json
from hil.cli.output import batch, duration_words, next_command, print_result
from hil.core.errors import BadInputError, RunInterruptedError, nearest

if TYPE_CHECKING:
    pass


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
    limit_s: Annotated[float | None, Option("--limit", metavar="S", help="a longer run ends as hung", min=1)] = None,
    redo: Annotated[
        str | None, Option(metavar="OUTCOMES", help="do the runs with these outcomes again, as in lost,refused")
    ] = None,
    allow_motion: AllowMotion = False,
    as_json: Json = False,
) -> None:
    """Do the runs of a campaign that are not done yet; exit 1 when one did not pass."""
    from hil.addons.batch.campaign.campaign import Campaign

    outcomes = _outcomes(redo)
    with batch(as_json=as_json) as progress:
        campaign = Campaign(plan, allow_motion=allow_motion)
        folder = out if out is not None else Path("runs") / campaign.plan.file.file.stem
        count = jobs or (1 if campaign.in_real_time or campaign.on_bench else os.cpu_count() or 1)
        if campaign.on_bench and count > 1:
            raise BadInputError(
                f"--jobs {count}: there is one bench behind the link or the pose fixes; it takes one run at a time"
            )
        total, counts = len(campaign.runs), Counter[str]()
        if dry_run:
            left = campaign.left(folder, outcomes)
            run_s, total_s = campaign.estimate_s(left, count)
            estimate = {"runs": total, "left": left, "workers": count, "run_s": run_s, "total_s": total_s}
            done = f", {total - left} of them done" if left < total else ""
            by = "1 worker" if count == 1 else f"{count} workers"
            text = f"{total} runs{done}; about {duration_words(total_s)} with {by}, {run_s:.2g} s a run"
            print_result(as_json, estimate, [text])
            return
        try:
            for rows in campaign.perform(folder, count, limit_s or 120.0 + 2.0 * campaign.longest_s, outcomes):
                counts.update(row["outcome"] for row in rows)
                if progress is not None:
                    progress(counts.total(), total, None, counts.total() - counts["passed"])
        except KeyboardInterrupt:
            raise RunInterruptedError(
                f"interrupted; {total - campaign.left(folder)} of {total} runs are done and saved in {folder}; run the "
                "same command to continue"
            ) from None
    passed = counts["passed"] == total
    words = ", ".join(f"{count} {outcome}" for outcome, count in counts.most_common())
    found = {"passed": passed, "folder": str(folder), "runs": total, "outcomes": dict(counts)}
    print_result(as_json, found, [f"{total} runs: {words}", next_command("hil", "campaign", "report", folder)])
    raise typer.Exit(0 if passed else 1)


@app.command("report")
def report(
    folder: Annotated[Path, Argument(metavar="DIR", help="the results of a campaign")],
    html: Html = None,
    pictures: Pictures = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Write one page about a campaign, DIR/report.html unless --html names another.

    It has pass rates, law against law, distributions, effects, and the worst runs.
    """
    from hil.addons.batch.campaign.campaign_page import results
    from hil.addons.batch.campaign.judged import Judged

    page = Page.of(html if html is not None else folder / "report.html", pictures, force=force)
    finish(results(Judged(folder), page), page, as_json=as_json)


def _outcomes(redo: str | None) -> frozenset[str]:
    from hil.addons.batch.job import STATUSES

    names = [] if redo is None else [name.strip() for name in redo.split(",")]
    if wrong := [name for name in names if name not in STATUSES]:
        raise BadInputError(
            f"--redo {redo}: {wrong[0]!r} is not an outcome{nearest(wrong[0], STATUSES)}; give some of "
            f"{', '.join(STATUSES)}, with commas between them"
        )
    return frozenset(names)
