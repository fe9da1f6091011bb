"""The plugin's fixtures as a user's tests have them, and what is left behind: nothing."""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil.review import review
from tests.plugin_suites import PASSING, PLUGIN, TOO_STRICT, cases, environment, properties, run, run_process, write
from tests.processes import is_running, wait_for
from tests.test_tick_watch import SLEEP, law

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals need a POSIX system")

SHORT = '{"loop.duration_s": 0.2, "expect": []}'


def pid_in(file: Path) -> int:
    return int(file.read_text() or 0) if file.exists() else 0


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

        def test_no_robot(virtual_robot):
            virtual_robot("paper_cirle")
        """
    )
    done = run(suite, "-p", "no:cacheprovider", "--hil-record", "kept", "-k", "not strict.hil")
    done.assert_outcomes(failed=4, passed=2, deselected=1)
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
    for ours in ("hil/cli/testing", "hil/scenario", "During handling"):
        assert ours not in done.stdout.str(), "the traceback shows the user's lines alone"


def test_a_robot_in_another_process_gives_the_same_bytes_and_ends_with_a_failed_test(
    suite: pytest.Pytester,
):
    suite.makepyfile(
        f"""
        from pathlib import Path

        def test_robot(virtual_robot, hil_run):
            robot = virtual_robot("paper_circle")
            Path("pid").write_text(str(robot.pid))
            assert robot.link.startswith("serial:/dev/") and robot.truth.startswith("tcp://127.0.0.1:")
            assert robot.is_running
            there = hil_run("paper_circle", set={SHORT}, on=robot, record=False)
            here = hil_run("paper_circle", set={SHORT}, record=False)
            assert there.metrics["link"] == robot.link
            assert there.metrics["wire_sha256"] == here.metrics["wire_sha256"]
            assert False, "fails with a robot that runs"
        """
    )
    done = run(suite, "--hil-set", "robot.mass_kg=21.0")
    done.assert_outcomes(failed=1)
    assert "fails with a robot that runs" in done.stdout.str()
    assert not is_running(pid_in(suite.path / "pid"))


@pytest.mark.alone
def test_an_open_link_carries_frames_made_by_hand(suite: pytest.Pytester):
    suite.makepyfile(
        """
        import pytest
        from firmware_protocol.framing import Frame
        from firmware_protocol.generated import messages as m
        from hil.core.errors import DeviceError

        def test_hello(hil_link, virtual_robot):
            link = hil_link(virtual_robot("paper_circle", mode="lockstep"))
            hello = link.ask(Frame(m.HelloRequest.ID, bytes([m.PROTOCOL_VERSION])), m.HelloIdentity)
            assert hello.schema_hash == m.SCHEMA_HASH
            while link.receive(0.05):
                pass
            assert link.ask(m.Step(0, 0), m.StepDone).tick == 0
            assert link.ask(m.Step(0, 5), m.StepDone).tick == 5
            assert not any(link.rejected().values())
            with pytest.raises(ValueError, match="0x7ff"):
                link.send(Frame(0x7FF, b""))
            with pytest.raises(DeviceError, match="no HelloIdentity within 0.01 s"):
                link.ask(m.Step(5, 0), m.HelloIdentity, timeout_s=0.01)

        def test_new_robot(hil_link):
            link = hil_link("paper_circle", mode="realtime")
            assert link.robot.mode == "realtime"
            assert isinstance(link.ask(m.HelloRequest(m.PROTOCOL_VERSION), m.HelloGeometry), m.HelloGeometry)
        """
    )
    run(suite).assert_outcomes(passed=2)


def test_a_robot_that_is_killed_in_mid_test_is_a_sentence(suite: pytest.Pytester):
    suite.makepyfile(
        """
        import threading
        from hil.robot.truth import TruthClient
        from firmware_protocol.generated.messages import State

        def kill_when_active(robot):
            truth = TruthClient(robot.truth, robot.scenario.hash, reset=False)
            while truth.poll() is None or truth.newest.state is not State.ACTIVE:
                pass
            truth.close()
            robot.kill()

        def test_killed(virtual_robot, hil_run):
            robot = virtual_robot("paper_circle")
            killer = threading.Thread(target=kill_when_active, args=(robot,))
            killer.start()
            try:
                hil_run("paper_circle", on=robot)
            finally:
                killer.join()
        """
    )
    done = run(suite, "--junit-xml", "report.xml")
    done.assert_outcomes(failed=1)
    done.stdout.re_match_lines([r"E\s+Failed: the (link|robot) failed, not an expectation: .*(lost|closed|ended)"])
    done.stdout.fnmatch_lines(["E*repeat it    pytest test_a_robot_*.py::test_killed"])
    assert "hil.failure" in properties(cases(suite.path / "report.xml")["test_killed"])


def test_a_robot_that_ends_by_itself_is_an_error_of_the_teardown(suite: pytest.Pytester):
    suite.makepyfile(
        """
        import os, signal

        def test_ended(virtual_robot):
            robot = virtual_robot("paper_circle")
            os.kill(robot.pid, signal.SIGKILL)
            while robot.is_running:
                pass
        """
    )
    done = run(suite)
    done.assert_outcomes(passed=1, errors=1)
    done.stdout.fnmatch_lines(["the virtual robot of paper_circle ended by itself: exit status -9"])


def test_a_robot_that_cannot_start_says_why(suite: pytest.Pytester):
    write(suite, good=PASSING)
    suite.makepyfile(
        """
        import pytest
        from hil.core.errors import BadInputError

        def test_no_robot(virtual_robot):
            with pytest.raises(BadInputError, match="mas_kg.*mass_kg"):
                virtual_robot("good.hil.toml", set={"robot.mas_kg": 3.0})
            with pytest.raises(BadInputError, match="did not start: .*serial:pty"):
                virtual_robot("good.hil.toml", link="memory:")
            with pytest.raises(BadInputError, match="missing.fmu"):
                virtual_robot("good.hil.toml", set={"plant.fmu": "./missing.fmu"})
        """
    )
    run(suite, "-k", "test_no_robot").assert_outcomes(passed=1, deselected=1)


ENDLESS = """
    import os
    from pathlib import Path

    def test_long(virtual_robot, hil_run, tmp_path):
        robot = virtual_robot("paper_circle")
        Path("pids").write_text(f"{robot.pid} {os.getpid()}")
        hil_run("paper_circle", on=robot, set={"loop.duration_s": 86400.0})
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
            robot, worker = map(int, (suite.path / "pids").read_text().split())
            # The recorder's process starts after its file was made.
            children = wait_for(lambda: found if len(found := children_of(worker)) >= 2 else None, 60.0)
            assert robot in children
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


def test_xdist_runs_scenarios_and_robots_side_by_side(suite: pytest.Pytester):
    write(suite, one=PASSING, strict=TOO_STRICT)
    suite.makepyfile(
        f"""
        import pytest

        @pytest.mark.parametrize("number", range(2))
        def test_robot(virtual_robot, hil_run, number):
            hil_run("paper_circle", set={SHORT}, on=virtual_robot("paper_circle"))
        """
    )
    options = ("-n", "2", "--hil-record", "kept", "--junit-xml", "report.xml")
    done = run_process(suite, *options)
    done.assert_outcomes(passed=3, failed=1)
    done.stdout.fnmatch_lines(["expectation: error.planar_m below 0.001*"])
    recordings = {properties(case)["hil.recording"] for case in cases(suite.path / "report.xml").values()}
    assert len(recordings) == 4
    assert {str(path) for path in (suite.path / "kept").rglob("*.rrd")} == recordings
