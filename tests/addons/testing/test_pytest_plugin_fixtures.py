"""The plugin's fixture as a user's tests have it, and what is left behind: nothing."""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil.judge.recorded import review
from tests.runtime.test_tick_watch import SLEEP, law
from tests.support.plugin_suites import (
    PASSING,
    PLUGIN,
    TOO_STRICT,
    cases,
    environment,
    properties,
    run,
    run_process,
    write,
)
from tests.support.processes import is_running, wait_for

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals need a POSIX system")

SHORT = '{"loop.duration_s": 0.2, "expect": []}'


def test_a_run_returns_its_result_records_and_reports(suite: pytest.Pytester):
    suite.makepyfile(
        f"""
        import numpy as np

        def test_two_runs(hil_run, tmp_path):
            first = hil_run("paper_circle", set={SHORT})
            heavy = {SHORT} | {{"plant.start.mass_kg": np.float64(26.0)}}
            second = hil_run("paper_circle", set=heavy, seed=5)
            assert first.passed and second.passed
            assert len(first.signals["loop.t_s"]) == 200
            assert second.scenario.plant.start["mass_kg"] == 26.0
            assert first.metrics["recording"] == str(tmp_path / "paper_circle.rrd")
            assert second.metrics["recording"] == str(tmp_path / "paper_circle-2.rrd")
            assert hil_run("paper_circle", set=["loop.duration_s=0.1", "expect=[]"], record=False).passed
        """
    )
    run(suite, "--junit-xml", "report.xml", "--hil-seed", "4").assert_outcomes(passed=1)
    kept = properties(cases(suite.path / "report.xml")["test_two_runs"])
    assert (kept["hil.seed"], kept["hil-2.seed"], kept["hil-3.ticks"]) == ("4", "5", "100")
    assert review(Path(kept["hil-2.recording"]))["wire_sha256"] == kept["hil-2.wire_sha256"] != kept["hil.wire_sha256"]
    assert "hil-3.recording" not in kept


@pytest.mark.parametrize("is_fixture", [True, False])
def test_a_law_that_no_exception_gets_to_ends_the_session_with_its_sentence(suite: pytest.Pytester, is_fixture: bool):
    stuck = law(suite.path, SLEEP)
    if is_fixture:
        limited = f'{{"loop.tick_limit_s": 0.2, "loop.duration_s": 1.0, "expect": [], "controller.law": {stuck!r}}}'
        suite.makepyfile(
            f"""
            def test_stuck(hil_run):
                hil_run("circle_speed", set={limited} | {{"controller.gains": {{}}}}, record=False)
            """
        )
    else:
        head = 'extends = "circle_speed"\nexpect = []\n[loop]\ntick_limit_s = 0.2\n[controller]\ngains = {}\n'
        write(suite, stuck=f'{head}law = "{stuck}"\n')
    ended = run_process(suite, "--hil-record", "none")
    assert ended.ret == 3
    assert "did not end within 0.2 s of wall-clock time" in ended.errlines[-1]


def test_a_run_that_does_not_pass_fails_the_test_unless_it_judges_itself(suite: pytest.Pytester):
    write(suite, strict=TOO_STRICT)
    suite.makepyfile(
        """
        import pytest
        from hil.core.errors import LinkError

        def test_checked(hil_run):
            hil_run("strict.hil.toml")

        def test_judged(hil_run):
            assert not hil_run("strict.hil.toml", check=False).passed

        def test_judged_and_failed(hil_run):
            assert hil_run("strict.hil.toml", check=False).passed

        def test_unreachable(hil_run):
            with pytest.raises(LinkError, match="ttyNOPE"):
                hil_run("paper_circle", link="serial:/dev/ttyNOPE", set=["estimator.source=odometry"], check=False)

        def test_misspelt(hil_run):
            hil_run("paper_cirle")
        """
    )
    done = run(suite, "-p", "no:cacheprovider", "--hil-record", "kept", "-k", "not strict.hil")
    done.assert_outcomes(failed=3, passed=2, deselected=1)
    done.stdout.fnmatch_lines(
        [
            "*_ test_checked _*",
            '>*hil_run("strict.hil.toml")',
            "E*Failed: expectation: error.planar_m below 0.001 from 0.1 s to the end: failed, 0.* at t = 0.1 s; *",
            "E*recording    kept/test_a_run_*.py/test_checked/strict.rrd",
            "E*repeat it    hil run strict.hil.toml --seed 1",
            "*_ test_judged_and_failed _*",
            "*- Captured hil call -*",
            "expectation: error.planar_m below 0.001*",
            "*_ test_misspelt _*",
            "E*Failed: scenario paper_cirle: no shipped scenario has this name; did you mean 'paper_circle'?*",
        ]
    )
    for ours in ("hil/addons/testing", "hil/scenario", "During handling"):
        assert ours not in done.stdout.str(), "the traceback shows the user's lines alone"


def test_a_line_between_changes_no_byte(suite: pytest.Pytester):
    suite.makepyfile(
        f"""
        def test_robot(hil_run):
            there = hil_run("paper_circle", set={SHORT}, link="serial:pty", record=False)
            here = hil_run("paper_circle", set={SHORT}, record=False)
            assert there.metrics["link"] == "serial:pty"
            assert there.metrics["wire_sha256"] == here.metrics["wire_sha256"]
        """
    )
    run(suite, "--hil-set", "robot.mass_kg=21.0").assert_outcomes(passed=1)


ENDLESS = """
    import os
    from pathlib import Path

    def test_long(hil_run, tmp_path):
        Path("pid").write_text(str(os.getpid()))
        hil_run("paper_circle", link="serial:pty", set={"loop.duration_s": 86400.0})
"""


def children_of(pid: int) -> list[int]:
    shown = subprocess.run(["ps", "-eo", "pid=,ppid="], capture_output=True, text=True, check=True).stdout
    return [int(child) for child, parent in map(str.split, shown.splitlines()) if int(parent) == pid]


@contextlib.contextmanager
def begun(suite: pytest.Pytester, *options: str) -> Iterator[tuple[subprocess.Popen[str], list[int]]]:
    """Start a session that would last a day of robot time; give it, and its children's process ids."""
    suite.makepyfile(ENDLESS)
    with subprocess.Popen(
        [sys.executable, "-m", "pytest", *PLUGIN, *options, "--basetemp", str(suite.path / "temp")],
        cwd=suite.path,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        stdin=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    ) as session:
        try:
            wait_for(lambda: list((suite.path / "temp").rglob("paper_circle.rrd")), 60.0)
            worker = int((suite.path / "pid").read_text())
            # The recorder's process starts after its file was made.
            children = wait_for(lambda: children_of(worker), 60.0)
            yield session, children
        finally:
            session.kill()


@pytest.mark.parametrize("options", [(), ("-n", "2")], ids=["one process", "xdist"])
def test_ctrl_c_leaves_no_process_behind(suite: pytest.Pytester, options: tuple[str, ...]):
    with begun(suite, *options) as (session, children):
        os.killpg(session.pid, signal.SIGINT)
        output, _ = session.communicate(timeout=60)
    assert session.returncode == pytest.ExitCode.INTERRUPTED, output
    wait_for(lambda: not any(map(is_running, children)))


def test_a_killed_session_leaves_no_process_behind(suite: pytest.Pytester):
    with begun(suite) as (session, children):
        session.kill()
        session.communicate(timeout=60)
    wait_for(lambda: not any(map(is_running, children)))


def test_xdist_runs_scenarios_and_fixtures_side_by_side(suite: pytest.Pytester):
    write(suite, one=PASSING, strict=TOO_STRICT)
    suite.makepyfile(
        f"""
        import pytest

        @pytest.mark.parametrize("number", range(2))
        def test_robot(hil_run, number):
            hil_run("paper_circle", set={SHORT}, link="serial:pty")
        """
    )
    options = ("-n", "2", "--hil-record", "kept", "--junit-xml", "report.xml")
    done = run_process(suite, *options)
    done.assert_outcomes(passed=3, failed=1)
    done.stdout.fnmatch_lines(["expectation: error.planar_m below 0.001*"])
    recordings = {properties(case)["hil.recording"] for case in cases(suite.path / "report.xml").values()}
    assert len(recordings) == 4
    assert {str(path) for path in (suite.path / "kept").rglob("*.rrd")} == recordings
