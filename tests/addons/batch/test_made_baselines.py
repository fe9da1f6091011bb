"""What is told where new runs of a scenario have other things than its baseline."""

from dataclasses import replace
from pathlib import Path

import pytest
import typer

from hil.addons.batch import baselines
from hil.addons.batch.baselines import Made, make_baselines
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
        return make_baselines([load(str(path))], 1)[0]

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
    monkeypatch.setattr(
        baselines, "run_jobs", lambda jobs, *_: [baselines.run(job, from_plain(job.scenario)) for job in jobs]
    )
    failing = 'extends = "circle_speed"\nloop.duration_s = 0.1\n[[expect]]\nsignal = "loop.t_s"\nbelow = 0.05\n'
    (path := tmp_path / "mine.toml").write_text(failing)
    with pytest.raises(typer.Exit) as ended:
        baselines.baseline([str(path)], seeds=2)
    assert ended.value.exit_code == 1
    assert not (tmp_path / "mine.baseline.toml").exists()
    name, *told = capsys.readouterr().out.splitlines()
    assert name == "mine"
    assert [line.split()[2] for line in told if line.startswith("  failed")] == ["1:", "2:"]
    assert told[-1].endswith("not made: it is made of runs that passed")
