"""What is told where new runs of a scenario have other things than its baseline."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import typer

from hil.addons.batch import baselines
from hil.addons.batch.baselines import Made, make_baselines
from hil.addons.batch.job import FAILED, Job, Outcome
from hil.scenario import from_plain, load
from hil.scenario.baseline import text_of


def test_what_a_baseline_did_not_have_and_where_it_was_made_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(  # runs are done in this process
        baselines, "run_jobs", lambda jobs, *_: [baselines.run(job, from_plain(job.scenario)) for job in jobs]
    )
    (path := tmp_path / "mine.toml").write_text('extends = "circle_speed"\nexpect = []\nloop.duration_s = 0.1\n')

    def made() -> Made:
        return make_baselines([load(str(path))], 1, workers=1, limit_s=60.0, allow_motion=False, on_progress=None)[0]

    first = made().new
    assert first is not None
    figure = dict(first.figure)
    effort_n_m_s = figure.pop("effort_n_m_s").value
    for change, told in (
        ({"wire_sha256": "0" * 64}, f"wire_sha256 is {first.wire_sha256[:12]}, not 000000000000"),
        ({"platform": "Plan 9 vax"}, f"it was made on Plan 9 vax, and this is {first.platform}"),
    ):
        text = text_of(replace(first, figure=figure, **change))
        (tmp_path / "mine.baseline.toml").write_text(text, encoding="utf-8")
        assert made().other == [f"effort_n_m_s: {effort_n_m_s:.6g}, which it did not have", told]


def test_no_baseline_is_made_of_runs_that_failed_and_the_command_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[Any] = []

    def run_jobs(jobs: list[Job], *given: object) -> list[Outcome]:
        asked.append((len(jobs), {(job.limit_s, job.allow_motion) for job in jobs}, given[0]))
        if given[0] == 1:  # in real time
            return [Outcome(job.key, FAILED, "too far") for job in jobs]
        return [baselines.run(job, from_plain(job.scenario)) for job in jobs]

    monkeypatch.setattr(baselines, "run_jobs", run_jobs)
    failing = 'extends = "circle_speed"\nloop.duration_s = 0.1\n[[expect]]\nsignal = "loop.t_s"\nbelow = 0.05\n'
    (path := tmp_path / "mine.toml").write_text(failing)
    with pytest.raises(typer.Exit) as ended:
        baselines.baseline([str(path)], seeds=2, jobs=3, limit_s=7.0)
    assert ended.value.exit_code == 1
    assert not (tmp_path / "mine.baseline.toml").exists()
    name, *told = capsys.readouterr().out.splitlines()
    assert name == "mine"
    assert [line.split()[2] for line in told if line.startswith("  failed")] == ["1:", "2:"]
    assert told[-1].endswith("not made: it is made of runs that passed")
    with pytest.raises(typer.Exit):
        baselines.baseline([str(path)], mode="realtime", seeds=4, jobs=3, allow_motion=True)
    assert asked == [(2, {(7.0, False)}, 3), (4, {(120.0, True)}, 1)], "real time is for one at a time"


def test_a_baseline_that_has_moved_is_written_where_that_is_accepted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(
        baselines, "run_jobs", lambda jobs, *_: [baselines.run(job, from_plain(job.scenario)) for job in jobs]
    )
    (path := tmp_path / "mine.toml").write_text('extends = "circle_speed"\nexpect = []\nloop.duration_s = 0.05\n')

    def made(**options: bool) -> tuple[int, str, dict[str, Any]]:
        with pytest.raises(typer.Exit) as ended:
            baselines.baseline([str(path)], seeds=2, **options)  # type: ignore[arg-type]
        told = capsys.readouterr().out.splitlines()
        with pytest.raises(typer.Exit) as again:
            baselines.baseline([str(path)], seeds=2, as_json=True)
        (found,) = json.loads(capsys.readouterr().out)["baselines"]
        assert again.value.exit_code == bool(found["moved"] or found["other"])
        return ended.value.exit_code, told[-1], found

    file = tmp_path / "mine.baseline.toml"
    code, line, found = made()
    whole = file.read_text(encoding="utf-8")
    assert (code, found["written"], found["moved"], found["failed"]) == (0, False, [], [])
    assert re.fullmatch(rf"  baseline +\d+ figures of 2 seeds in {re.escape(str(file))}", line)
    assert made()[1].endswith(f"nothing has moved from {file}")
    file.write_text(re.sub(r'(wire_sha256 = ")\w{12}', r"\g<1>000000000000", whole), encoding="utf-8")
    changed = file.read_text(encoding="utf-8")
    code, line, found = made()
    assert (code, found["written"], len(found["other"])) == (1, False, 1)
    assert line.endswith(f"{file} stays as it is; if the change is meant, add --accept")
    assert file.read_text(encoding="utf-8") == changed
    code, line, found = made(accept=True)
    assert (code, found["other"], file.read_text(encoding="utf-8")) == (0, [], whole)
