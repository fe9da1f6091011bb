"""A campaign's plan: what is wrong in it is a sentence before anything runs; what it would take is told."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hil.addons.batch.campaign.campaign import Campaign
from hil.cli.main import app
from hil.core.errors import BadInputError
from tests.support.campaigns import in_process, write_plan


def test_what_is_wrong_with_a_plan_is_a_sentence_with_its_line_before_anything_runs(tmp_path: Path) -> None:
    axes = "[axes]\n{}"
    for more, tables, sentence in (
        ("", axes.format("robot.mas_kg = { grid = [1] }"), "plan.toml:9: unknown key robot.mas_kg; did you mean"),
        ("", axes.format('"robot.mass_kg" = { grid = [20, -3] }'), "plan.toml:9: robot.mass_kg = -3"),
        ("", axes.format('"robot.mass_kg" = { gird = [20] }'), "did you mean 'axes.robot.mass_kg.grid'?"),
        ("", axes.format('"robot.mass_kg" = { uniform = [20, 3] }\n'), "expected [low, high] with low < high"),
        ("", axes.format('"robot.mass_kg" = { uniform = [3, 20] }\n'), "say with samples = N how often to draw"),
        ("", axes.format('"robot.mass_kg" = { grid = [3, 3] }\n'), "plan.toml:9: axes.robot.mass_kg: grid: a value is"),
        (
            "",
            axes.format("a.b = { list = [1, 2] }\nc.d = { list = [1] }"),
            "lists go together in step and need one length, but a.b has 2, c.d has 1; give grid for each with each",
        ),
        ("", axes.format('"loop.seed" = { grid = [1, 2] }'), "axes loop.seed: give seeds instead"),
        ("seeds = 0", "", "plan.toml:3: seeds = 0; expected how many, from 1 to"),
        ("sceds = 3", "", "plan.toml:3: unknown key sceds; did you mean 'seeds'?"),
        ('keep = "some"', "", 'plan.toml:3: keep = "some"; expected'),
        ('laws = ["afdcs"]', "", "controller.law = 'afdcs': unknown; did you mean 'afdsc'?"),
        (
            'laws = ["dsc", { law = "dsc", name = "other" }]',
            "",
            "two runs are the same: dsc, seed 1; and other, seed 1",
        ),
        ("", '[[fault]]\nname = "x"\nrows = [{ kind = "dorp" }]', "did you mean 'drop'?"),
        ("", axes.format("robt.mass_kg = { grid = [1] }"), "plan.toml:9: unknown key robt; did you mean 'robot'?"),
        ("", axes.format('"plant.start.mas_kg" = { grid = [1] }'), "has no such variable; did you mean 'mass_kg'?"),
        ("", axes.format('"plant.start.mass_kg" = { grid = ["a"] }'), "plant.start.mass_kg = 'a'; expected a finite"),
        ('laws = [{ law = "dsc", gains = { k1 = 9.0 } }]', "", "unknown key controller.gains.k1"),
        (
            'laws = ["./a/law.py:Law", "./b/law.py:Law"]',
            "",
            "plan.toml:3: two laws are both called 'Law', and a report",
        ),
        ("seeds = 2", "loop.seed = 7", "loop.seed is in [set], and there are seeds"),
        (
            'laws = [{ law = "dsc", gains = { k1_1_s = 9.0 } }]',
            axes.format("controller.gains.k1_1_s = { grid = [1, 2] }"),
            "controller.gains.k1_1_s is in laws and in [axes]",
        ),
        ('laws = "dsc"', "", 'plan.toml:3: laws = "dsc"; expected an array'),
        ("", axes.format('"robot.mass_kg" = { log_uniform = [0, 3] }'), "log_uniform = [0.0, 3.0]; expected numbers"),
        ("", axes.format('"robot.mass_kg" = { uniform = [3, 3] }'), "uniform = [3.0, 3.0]; expected [low, high]"),
        ("", axes.format('"robot.mass_kg" = { list = [] }'), "axes.robot.mass_kg: list has no values; give at least"),
        ("", axes.format('"robot.mass_kg" = { grid = [1], list = [1] }'), "expected one of grid, list, uniform, log_u"),
        (
            "samples = 2",
            axes.format('"robot.mass_kg" = { grid = [1] }'),
            "samples belongs to random axes, and there is",
        ),
        ("samples = 2", "", "samples belongs to random axes, and there is none; remove it"),
        ("", axes.format('"controller.law" = { grid = ["dsc"] }'), "axes controller.law: give laws instead"),
        ("", axes.format("fault = { grid = [1] }"), "axes fault: give [[fault]] instead"),
        ("", axes.format("expect = { grid = [1] }"), "axes expect: give [[expect]] instead"),
        (
            "",
            axes.format("loop.duration_s = { grid = [1] }"),
            "loop.duration_s is in [set] and in [axes]; give it",
        ),
        (
            'laws = ["pid", { law = "dsc", command = "torque" }]',
            axes.format('controller.command = { grid = ["speed"] }'),
            "controller.command is in laws and in [axes]",
        ),
        (
            'laws = [{ law = "pid", name = "x" }, { law = "dsc", name = "x" }]',
            "",
            "two of law have one name; name",
        ),
        ("", '[[fault]]\nname = "x"\n[[fault]]\nname = "x"\n', "two of fault have one name; name each otherwise"),
        ("seeds = [7, 7]", "", "plan.toml:3: seeds = [7, 7]; a seed is named twice; name each once"),
        ("seeds = [4294967296]", "", "expected seeds from 0 to 4294967295"),
        ("seeds = [-1]", "", "expected seeds from 0 to 4294967295"),
        ("seeds = [1.5]", "", "seeds = [1.5]; expected how many, from 1 to 10000000, or an array of seeds"),
        ("seeds = true", "", "seeds = true; expected how many, from 1 to 10000000, or an array of seeds"),
        ("seeds = 10000001", "", "seeds = 10000001; expected how many, from 1 to 10000000, or an array of seeds"),
        (
            "",
            '[[expect]]\nsignal = "truth.x_m"\nfrom_s = 0.2\nbelow = 9.0',
            "plan.toml: dsc, seed 1: the expectation of truth.x_m begins at 0.2 s, and the run ends at 0.2 s: it would",
        ),
    ):
        plan = write_plan(tmp_path, more, tables)
        with pytest.raises(BadInputError) as refused:
            Campaign(plan)
        assert sentence in str(refused.value)
    for more, tables, count in (
        ("seeds = [0, 4294967295]", "", 2),
        ("samples = 1", axes.format('"robot.mass_kg" = { log_uniform = [1e-3, 30] }'), 1),
        ("", '[[expect]]\nsignal = "truth.x_m"\nfrom_s = 0.19\nbelow = 9.0', 1),
        ('laws = [{ law = "dsc", command = "torque" }, "dsc"]', "", 2),
    ):
        assert len(Campaign(write_plan(tmp_path, more, tables)).runs) == count
    with pytest.raises(BadInputError, match=r"no\.toml: there is no such file; give the path of a \.toml file"):
        Campaign(tmp_path / "no.toml")


def test_what_is_behind_a_link_is_asked_what_it_cannot_do_before_anything_runs(tmp_path: Path) -> None:
    url, odometry = 'link.url = "can:socketcan/can0"\n', 'estimator.source = "odometry"\n'
    makers = f'{url}{odometry}device.driver = "c620"\n'
    for tables, sentence in (
        (url, 'estimator.source = "truth", and of a robot behind a link no truth is known'),
        (
            makers,
            "link.url = 'can:socketcan/can0': the protocol of 'c620' has no STEP, so that nobody can let its time pass "
            'from outside; give loop.mode = "realtime", or link.url = "memory:"',
        ),
        (f'{makers}loop.mode = "realtime"', "real motors would move; add --allow-motion"),
    ):
        plan = write_plan(tmp_path, 'keep = "none"', tables)
        done = CliRunner().invoke(app, ["campaign", str(plan), "--dry-run", "--jobs", "1"])
        assert isinstance(done.exception, BadInputError)
        assert sentence in str(done.exception)
    assert Campaign(plan, allow_motion=True).on_bench
    bench = write_plan(tmp_path, 'keep = "none"', f"{url}{odometry}", name="bench.toml")
    dry = json.loads(in_process("campaign", bench, "--dry-run", "--json", "--out", tmp_path / "out"))
    assert dry == {"runs": 1, "left": 1, "workers": 1, "run_s": 1.2, "total_s": 1.2}  # --jobs 1 is not needed
    three = write_plan(tmp_path, 'keep = "none"\nseeds = 3', f"{url}{odometry}", name="bench.toml")
    told = in_process("campaign", three, "--dry-run", "--out", tmp_path / "out")
    assert told == "3 runs; about 4 s with 1 worker, 1.2 s a run\n"
    real = Campaign(write_plan(tmp_path, 'keep = "none"', 'loop.mode = "realtime"'))
    assert (real.on_bench, real.in_real_time, real.estimate_s(7, 2)) == (False, True, (1.2, 4 * 1.2))
    simulated = 'estimator.source = "fused"\nestimator.fix = "simulated"'
    assert not Campaign(write_plan(tmp_path, 'keep = "none"', simulated)).on_bench
    fixes = 'loop.mode = "realtime"\nestimator.source = "fused"\nestimator.fix = "udp://127.0.0.1:5000"'
    plan = write_plan(tmp_path, 'keep = "none"', fixes)
    done = CliRunner().invoke(app, ["campaign", str(plan), "--dry-run", "--jobs", "2"])
    assert "there is one bench behind the link or the pose fixes" in str(done.exception)
