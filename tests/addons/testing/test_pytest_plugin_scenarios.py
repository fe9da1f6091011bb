"""``*.hil.toml`` files as tests: their collection, messages of failures, and contents of reports."""

import re
import shlex
import shutil
import sys
from pathlib import Path

import pytest

from hil.judge.recorded import review
from hil.scenario.load import SHIPPED_DIRECTORY
from tests.support.plugin_suites import (
    BAD_KEY,
    HOLDING,
    NEVER_APPLIED,
    NO_FMU,
    PASSING,
    TOO_STRICT,
    WATCHDOG,
    cases,
    properties,
    run,
    write,
)
from tests.support.processes import device, hil


def test_every_file_is_one_test_that_its_name_and_the_marker_select(suite: pytest.Pytester):
    write(suite, circle=PASSING, line=PASSING)
    (suite.path / "no_test.toml").write_text(PASSING)
    shutil.copy(SHIPPED_DIRECTORY / "paper_circle.baseline.toml", suite.path / "line.baseline.toml")
    suite.makepyfile(test_other="def test_other(): pass")
    listed = run(suite, "--co", "-q", "--strict-markers")
    assert listed.parseoutcomes() == {"tests": 3}
    listed.stdout.fnmatch_lines(["circle.hil.toml::circle", "line.hil.toml::line", "test_other.py::test_other"])
    for options, names in (
        (("-m", "hil"), ["circle", "line"]),
        (("-m", "not hil"), ["test_other"]),
        (("-k", "circle"), ["circle"]),
        (("line.hil.toml",), ["line"]),
        (("line.baseline.toml", "line.hil.toml"), ["line"]),  # as a shell names them by *.toml
        (("line.hil.toml::line",), ["line"]),
    ):
        found = [line.partition("::")[2] for line in run(suite, "--co", "-q", *options).outlines if "::" in line]
        assert found == names


def test_a_failed_expectation_tells_what_when_and_how_to_go_on(suite: pytest.Pytester):
    write(suite, strict=TOO_STRICT, good=HOLDING)
    done = run(suite, "--hil-set", "robot.mass_kg=21.0", "--hil-seed", "7")
    done.assert_outcomes(failed=1, passed=1)
    done.stdout.fnmatch_lines(
        [
            "*_ scenario strict _*",
            "expectation: error.planar_m below 0.001 from 0.1 s to the end: failed, 0.* at t = 0.1 s; worst 0.*",
            "",
            "  scenario     strict.hil.toml, lockstep, memory:, seed 7",
            "  expectation  error.planar_m below 0.001 from 0.1 s to the end: failed, 0.* at t = 0.1 s; worst 0.*",
            "  recording    *strict.rrd",
            "  look at it   hil view *strict.rrd",
            "               hil review *strict.rrd",
            "  repeat it    hil run strict.hil.toml --seed 7 --set robot.mass_kg=21.0",
            "FAILED strict.hil.toml::strict - Failed: expectation: error.planar_m below 0.001*",
        ]
    )
    assert "Traceback" not in done.stdout.str()
    recording = Path(re.findall(r"recording +(\S+)", done.stdout.str())[0])
    figures = review(suite.path / recording)
    repeated = hil(*shlex.split(command(done))[1:], "--record", "none", "--json", cwd=suite.path)
    assert repeated.returncode == 1
    assert f'"wire_sha256": "{figures["wire_sha256"]}"' in repeated.stdout
    assert not list(suite.path.rglob("good.rrd")), "a run that passed leaves no recording unless one is asked for"


def command(done: pytest.RunResult) -> str:
    return re.findall("repeat it +(.*)", done.stdout.str())[0]


def test_a_fault_that_was_never_applied_fails_and_is_named(suite: pytest.Pytester):
    write(suite, fault=NEVER_APPLIED)
    done = run(suite, "--hil-record", "none")
    done.assert_outcomes(failed=1)
    done.stdout.fnmatch_lines(
        [
            "fault: mute ESTOP from 0.1 s: never applied, so the run shows nothing about it",
            "  recording    none was kept",
        ]
    )


def test_a_stopped_robot_is_told_apart_from_a_failed_expectation(suite: pytest.Pytester):
    write(suite, silence=WATCHDOG)
    done = run(suite, "--junit-xml", "report.xml")
    done.stdout.fnmatch_lines(
        ["the robot failed, not an expectation: the robot left ACTIVE at t = * COMMAND_TIMEOUT*", "*mute*: applied*"]
    )
    case = cases(suite.path / "report.xml")["silence"]
    assert "COMMAND_TIMEOUT" in properties(case)["hil.failure"]
    failure = case.find("failure")
    assert failure is not None
    assert failure.attrib["message"].startswith("Failed: the robot failed, not an expectation: ")


def test_a_link_that_cannot_be_opened_is_a_sentence(suite: pytest.Pytester):
    write(suite, elsewhere=PASSING)
    done = run(suite, "--hil-link", "serial:/dev/ttyNOPE", "--hil-set", "estimator.source=odometry")
    done.assert_outcomes(failed=1)
    done.stdout.fnmatch_lines(
        [
            "the link failed, not an expectation: *'/dev/ttyNOPE' does not exist*",
            "  repeat it    hil run elsewhere.hil.toml --link serial:/dev/ttyNOPE --seed 1 --set estimator.source=*",
        ]
    )
    assert "Traceback" not in done.stdout.str()


@pytest.mark.parametrize(
    ("text", "options", "words"),
    [
        (BAD_KEY, (), "scenario bad.hil.toml:3: unknown key robot.mas_kg; did you mean 'robot.mass_kg'?"),
        ("[robot\n", (), "*bad.hil.toml*not valid TOML*line 1*"),
        (PASSING, ("--hil-mode", "lockstpe"), "*lockstpe*lockstep*"),
        (PASSING, ("--hil-set", "robot.mas_kg=3"), "--set*mas_kg*mass_kg*"),
        (PASSING, ("--hil-link", "seral:x"), "*seral*serial*"),
    ],
)
def test_a_scenario_that_is_wrong_is_an_error_of_the_collection_in_one_sentence(
    suite: pytest.Pytester, text: str, options: tuple[str, ...], words: str
):
    write(suite, bad=text)
    done = run(suite, *options)
    done.assert_outcomes(errors=1)
    assert done.ret == pytest.ExitCode.INTERRUPTED
    done.stdout.fnmatch_lines(["*ERROR collecting bad.hil.toml*", words, "*short test summary*"], consecutive=True)


def test_a_missing_fmu_fails_the_test_in_one_sentence(suite: pytest.Pytester):
    write(suite, plant=NO_FMU)
    done = run(suite)
    done.assert_outcomes(failed=1)
    done.stdout.fnmatch_lines(["*_ scenario plant _*", "*missing.fmu*does not exist*", ""], consecutive=True)


def test_junit_keeps_figures_seed_hash_and_recording(suite: pytest.Pytester):
    write(suite, strict=TOO_STRICT, good=HOLDING)
    run(suite, "--junit-xml", "report.xml", "--hil-record", "kept", "--hil-seed", "3")
    found = cases(suite.path / "report.xml")
    assert {name: [child.tag for child in case] for name, case in found.items()} == {
        "good": ["properties"],
        "strict": ["properties", "failure"],
    }
    for name, case in found.items():
        kept = properties(case)
        assert kept["hil.scenario"] == name
        assert kept["hil.seed"] == "3"
        assert kept["hil.ticks"] == "200"
        figures = review(Path(kept["hil.recording"]))
        assert kept["hil.wire_sha256"] == figures["wire_sha256"]
        link = figures["link_statistics"]
        assert kept["hil.link.sent_bytes"] == str(link["sent"]["bytes"])
        assert kept["hil.link.round_trip_p99_ms"] == str(link["round_trip_ms"]["p99"])
        assert (kept["hil.link.lost_snapshots"], kept["hil.link.recoveries"]) == ("0", "0")
        assert "hil.link.worst_load_percent" not in kept, "memory has no bit rate"
        assert figures["passed"] is (name == "good")
        assert Path(kept["hil.recording"]) == suite.path / "kept" / f"{name}.rrd"
    failure = found["strict"].find("failure")
    assert failure is not None
    assert "error.planar_m below 0.001" in failure.attrib["message"]
    assert "hil review" in (failure.text or "")


TWO_RUNS = """
import pytest
@pytest.mark.parametrize("attempts", [[]])
def test_of_runs(hil_run, attempts):
    attempts.append(0)
    hil_run("paper_circle", set=["loop.duration_s=0.1", "expect=[]"])
    if len(attempts) == 1:
        hil_run("paper_circle", set=["loop.duration_s=0.1", "expect=[]"])
        pytest.fail("the first attempt")
"""


def test_junit_has_the_last_attempt_of_a_test_that_is_run_again(suite: pytest.Pytester):
    pytest.importorskip("pytest_rerunfailures")
    write(suite, strict=TOO_STRICT)
    suite.makepyfile(TWO_RUNS)
    run(suite, "-p", "rerunfailures", "--reruns", "2", "--junit-xml", "report.xml", "--hil-record", "none")
    for case in cases(suite.path / "report.xml").values():
        names = [row.attrib["name"] for row in case.iterfind("properties/property")]
        assert len(names) == len(set(names)) > 10
        assert not any(name.startswith("hil-2") for name in names)


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals need a POSIX system")
def test_scenarios_run_on_a_robot_elsewhere(suite: pytest.Pytester):
    write(suite, good=HOLDING)
    shared = ("--set", "robot.mass_kg=21.0", "--seed", "9")
    with device("paper_circle", "--mode", "lockstep", "--link", "serial:pty", *shared) as robot:
        there = ("--hil-link", robot.link, "--hil-truth", robot.truth, "--hil-mode", "lockstep")
        changed = ("--hil-set", "robot.mass_kg=21.0", "--hil-seed", "9")
        run(suite, *there, *changed, "--junit-xml", "report.xml").assert_outcomes(passed=1)
        other = run(suite, *there)
        other.assert_outcomes(failed=1)
    kept = properties(cases(suite.path / "report.xml")["good"])
    assert (kept["hil.mode"], kept["hil.link"]) == ("lockstep", robot.link)
    other.stdout.fnmatch_lines(
        [
            "the robot failed, not an expectation: truth * another scenario*",
            f"  repeat it    hil run good.hil.toml --mode lockstep --link {robot.link} --seed 1 --truth {robot.truth}",
        ]
    )


def test_first_failure_ends_the_session_and_last_failed_runs_it_alone(suite: pytest.Pytester):
    write(suite, a_good=PASSING, b_strict=TOO_STRICT, c_good=PASSING)
    run(suite, "-x").assert_outcomes(passed=1, failed=1)
    again = run(suite, "--lf", "--hil-set", "expect.1.below=1.0")
    again.assert_outcomes(passed=1)


def test_a_folder_for_recordings_that_cannot_be_made_is_a_sentence(suite: pytest.Pytester):
    write(suite, good=PASSING)
    (suite.path / "taken").write_text("a file")
    done = run(suite, "--hil-record", "taken/here")
    done.assert_outcomes(failed=1)
    done.stdout.fnmatch_lines(["--hil-record taken/here: *taken/here cannot be made (Not a directory)"])
    done = run(suite, "-p", "no:tmpdir")
    done.stdout.fnmatch_lines(["recordings need a folder: give --hil-record DIR*"])
