"""The plugin on runs that are made up: what it asks for, where recordings go, what fails and what is reported."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from hil.addons.testing.checked_run import forget_runs, run_as_test
from hil.addons.testing.plugin import _places
from hil.core.errors import BadInputError, DeviceError, HilError, LinkError
from hil.runtime import assembly
from hil.runtime.assembly import RunOptions
from hil.scenario import Scenario, load
from hil.scenario.load import SHIPPED_DIRECTORY
from tests.addons.testing.test_checked_run import metrics
from tests.support.made_runs import made_runs
from tests.support.plugin_suites import PASSING, PLUGIN, cases, properties, write

FAILED, PASSED = (made.judged for made in made_runs())
WHY = "error.planar_m below 0.02 from 0.5 s to 1.5 s: failed, 0.0308 at t = 0.78 s"


def outcome(*, passed: bool, failure: HilError | None = None) -> Any:
    run = PASSED if passed else replace(FAILED, failure=None)
    return SimpleNamespace(passed=passed, failure=failure, run=run, metrics=metrics())


class Made(list[tuple[Scenario, RunOptions]]):
    """What was asked for. A scenario whose name begins with "strict" fails, one with "far" is not reached."""

    def __call__(self, scenario: Scenario, options: RunOptions) -> Any:
        self.append((scenario, options))
        if scenario.name.startswith("far"):
            raise LinkError("nobody answers")
        if options.record is not None:
            options.record.write_text(f"recorded {len(self)}")
        return outcome(passed=not scenario.name.startswith("strict"))

    def records(self) -> list[Path | None]:
        return [options.record for _, options in self]


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Made:
    runs = Made()
    monkeypatch.setattr(assembly, "run_scenario", runs)
    return runs


@pytest.fixture
def session(suite: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> Callable[..., pytest.RunResult]:
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")  # others take longer than what is tested
    return lambda *words: suite.runpytest_inprocess(*PLUGIN, "-p", "no:cacheprovider", *words)


Session = Callable[..., pytest.RunResult]


def test_a_scenario_that_passed_leaves_no_recording_and_one_that_failed_says_where_it_is(
    suite: pytest.Pytester, session: Session, made: Made
) -> None:
    write(suite, good=PASSING, strict=PASSING)
    # As a shell names them by *.toml.
    shutil.copy(SHIPPED_DIRECTORY / "paper_circle.baseline.toml", suite.path / "good.baseline.toml")
    words = ("--hil-seed", "7", "--hil-set", "robot.mass_kg=21.0", "--hil-mode", "lockstep")
    done = session("good.hil.toml", "good.baseline.toml", "strict.hil.toml", *words, "--junit-xml", "report.xml")
    done.assert_outcomes(passed=1, failed=1)
    assert [(scenario.name, scenario.loop.seed, scenario.robot.mass_kg) for scenario, _ in made] == [
        ("good", 7, 21.0),
        ("strict", 7, 21.0),
    ]
    good, strict = made.records()
    assert good is not None
    assert strict is not None
    assert not good.exists()
    assert (strict.name, strict.parent.name, strict.read_text()) == ("strict.rrd", "strict0", "recorded 2")
    done.stdout.fnmatch_lines(
        [
            "*_ scenario strict _*",
            f"expectation: {WHY}*",
            "  scenario     strict.hil.toml, lockstep, memory:, seed 7",
            f"  recording    {strict}",
            "  repeat it    hil run strict.hil.toml --mode lockstep --seed 7 --set robot.mass_kg=21.0",
            "FAILED strict.hil.toml::strict - Failed: expectation: *",
        ]
    )
    assert "Traceback" not in done.stdout.str()
    found = {name: properties(case) for name, case in cases(suite.path / "report.xml").items()}
    assert (found["good"]["hil.scenario"], "hil.recording" in found["good"]) == ("good", False)
    assert found["strict"]["hil.recording"] == str(strict)


def test_recordings_are_kept_below_the_folder_that_is_asked_for_and_never_replaced(
    suite: pytest.Pytester, session: Session, made: Made
) -> None:
    (suite.path / "more").mkdir()
    write(suite, good=PASSING)
    (suite.path / "more" / "deep.hil.toml").write_text(PASSING)
    suite.makepyfile(test_it="def test_fixture(hil_run):\n    hil_run('paper_circle')\n    hil_run('paper_circle')\n")
    for _ in range(2):
        session("--hil-record", "kept").assert_outcomes(passed=3)
    kept = suite.path / "kept"
    own = ("more/deep", "good", "test_it.py/test_fixture/paper_circle", "test_it.py/test_fixture/paper_circle-2")
    assert set(made.records()) == {kept / f"{name}{number}.rrd" for name in own for number in ("", "_2")}
    assert all(path is not None and path.exists() for path in made.records())
    made.clear()
    done = session("--hil-record", "none", "-k", "good or fixture")
    done.assert_outcomes(passed=2, deselected=1)
    assert made.records() == [None] * 3
    (suite.path / "taken").write_text("a file")
    done = session("--hil-record", "taken/here", "good.hil.toml")
    done.stdout.fnmatch_lines(["--hil-record taken/here: *taken/here cannot be made (Not a directory)"])
    done = session("-p", "no:tmpdir", "good.hil.toml")
    done.stdout.fnmatch_lines(["recordings need a folder: give --hil-record DIR, or remove -p no:tmpdir"])


def test_scenarios_and_tests_of_runs_are_selected_by_the_marker(
    suite: pytest.Pytester, session: Session, made: Made
) -> None:
    write(suite, good=PASSING)
    suite.makepyfile(test_it="def test_fixture(hil_run): pass\ndef test_other(): pass\n")
    for words, names in ((("-m", "hil"), ["good", "test_fixture"]), (("-m", "not hil"), ["test_other"])):
        listed = session("--co", "-q", "--strict-markers", *words).outlines
        assert [line.partition("::")[2] for line in listed if "::" in line] == names
    assert "hardware in the loop (*.hil.toml, and the fixture hil_run):" in session("--help").stdout.str()


def test_the_fixture_runs_what_the_test_says_with_numbers_of_its_own_in_the_report(
    suite: pytest.Pytester, session: Session, made: Made
) -> None:
    (folder := suite.path / "below").mkdir()
    for name in ("near", "strict"):
        (folder / f"{name}.toml").write_text(PASSING)
    (folder / "test_it.py").write_text(
        """
from pathlib import Path

def test_runs(hil_run, tmp_path):
    Path("where").write_text(str(tmp_path))
    assert hil_run("paper_circle", set={"robot.mass_kg": 21.0}, seed=5).passed
    hil_run("near.toml", record=False, mode="realtime")
    hil_run(Path("near.toml"), link="serial:/dev/ttyX", truth="tcp://a:1")
    assert not hil_run("strict.toml", check=False).passed
    assert False, "so that its output is shown"

def test_strict(hil_run):
    hil_run("strict.toml")
"""
    )
    done = session("--junit-xml", "report.xml", "--hil-seed", "4", "--hil-link", "memory:")
    done.assert_outcomes(failed=2)
    tmp_path = Path((suite.path / "where").read_text())
    assert [(one.name, one.loop.seed, one.loop.mode, one.link.url) for one, _ in made[:4]] == [
        ("paper_circle", 5, "lockstep", "memory:"),
        ("near", 4, "realtime", "memory:"),
        ("near", 4, "lockstep", "serial:/dev/ttyX"),
        ("strict", 4, "lockstep", "memory:"),
    ]
    assert made[0][0].robot.mass_kg == 21.0
    assert [options.truth for _, options in made[:4]] == [None, None, "tcp://a:1", None]
    names = ("paper_circle.rrd", None, "near-3.rrd", "strict-4.rrd")
    assert made.records()[:4] == [None if name is None else tmp_path / name for name in names]
    done.stdout.fnmatch_lines(
        [
            "*_ test_runs _*",
            "*- Captured hil call -*",
            f"expectation: {WHY}*",
            "*_ test_strict _*",
            '*hil_run("strict.toml")',
            f"E*Failed: expectation: {WHY}*",
        ]
    )
    assert "hil/addons/testing" not in done.stdout.str(), "the traceback shows the user's lines alone"
    kept = properties(cases(suite.path / "report.xml")["test_runs"])
    scenarios = [kept[f"hil{number}.scenario"] for number in ("", "-2", "-3", "-4")]
    assert scenarios == ["paper_circle", "near", "near", "strict"]
    assert not any(name.startswith(("hil-1.", "hil-5.")) for name in kept)


def test_a_run_that_cannot_begin_fails_the_test_unless_that_judges_itself(
    suite: pytest.Pytester, session: Session, made: Made
) -> None:
    write(suite, far=PASSING)
    suite.makepyfile(
        """
        import pytest
        from hil.core.errors import BadInputError, LinkError

        def test_judged(hil_run):
            with pytest.raises(LinkError, match="nobody answers"):
                hil_run("far.hil.toml", check=False)
            with pytest.raises(BadInputError, match="paper_cirle"):
                hil_run("paper_cirle", check=False)

        def test_checked(hil_run):
            hil_run("far.hil.toml")

        def test_misspelt(hil_run):
            hil_run("paper_cirle")
        """
    )
    done = session("-k", "not far.hil")
    done.assert_outcomes(passed=1, failed=2, deselected=1)
    done.stdout.fnmatch_lines(
        [
            "E*Failed: the link failed, not an expectation: nobody answers",
            "E*recording    none was kept",
            "E*Failed: scenario paper_cirle: no shipped scenario has this name; did you mean 'paper_circle'?*",
        ]
    )


def test_an_attempt_again_leaves_nothing_of_the_earlier_one_in_the_report() -> None:
    mine = [("other", "1"), ("hilarious", "2"), ("hil-x.seed", "3")]
    kept = [("hil.seed", "1"), mine[0], ("hil-2.seed", "5"), mine[1], ("hil-13.seed", "5"), mine[2]]
    item = SimpleNamespace(user_properties=kept)
    forget_runs(cast("pytest.Item", item))
    assert item.user_properties is kept
    assert kept == mine


def _config(**hooks: Any) -> tuple[Any, list[Any]]:
    suspended: list[Any] = []
    capture = SimpleNamespace(suspend_global_capture=lambda in_: suspended.append(in_))
    plugins = SimpleNamespace(getplugin=lambda name: capture if name == "capturemanager" else None)
    hook = SimpleNamespace(pytest_hil_run_options=hooks.get("change", lambda options: None))
    return SimpleNamespace(pluginmanager=plugins, hook=hook), suspended


def test_other_plugins_change_options_and_a_law_that_is_stuck_is_seen(made: Made, tmp_path: Path) -> None:
    scenario = load("circle_speed")
    config, suspended = _config()
    checked = run_as_test(scenario, "tcp://a:1", tmp_path / "a.rrd", "hil run it", config)
    ((_, options),) = made
    assert (options.truth, options.record, options.lenient) == ("tcp://a:1", tmp_path / "a.rrd", False)
    assert (checked.passed, checked.error, checked.recording) == (True, None, tmp_path / "a.rrd")
    assert suspended == []
    assert options.on_stuck is not None
    options.on_stuck("it does not end")
    assert suspended == [False], "standard input stays as it is"
    config.pluginmanager.getplugin = lambda _: None  # with -p no:capture
    options.on_stuck("it does not end")
    config, _ = _config(change=lambda options: replace(options, lenient=True))
    checked = run_as_test(scenario, None, None, "hil run it", config)
    assert (made[1][1].lenient, made[1][1].truth, checked.recording) == (True, None, None)


@pytest.mark.parametrize("error", [DeviceError("hot"), BadInputError("wrong")])
def test_an_error_before_a_run_and_one_that_ended_it_are_both_its_outcome(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, error: HilError
) -> None:
    def raises(*_: object) -> None:
        raise error

    def ended(*_: object) -> Any:
        return outcome(passed=False, failure=error)

    for runs, has_result in ((raises, False), (ended, True)):
        monkeypatch.setattr(assembly, "run_scenario", runs)
        checked = run_as_test(load("circle_speed"), None, tmp_path / "none.rrd", "hil run it", _config()[0])
        assert checked.error is error
        assert (checked.result is not None, checked.passed) == (has_result, False)
        assert checked.recording is None, "none was made"


def test_recordings_of_two_tests_never_have_one_place() -> None:
    names = ["a/b.py::t", "a/b_py::t", "../b.py::t", "b.py::t", "b.py::t[a/b]", "b.py::t[a%2Fb]", "b.py::t[a::b]"]
    names += [f"b.py::t[{'x' * 300}{end}]" for end in "12"]
    places = [_places(name) for name in names]
    assert len(set(map(tuple, places))) == len(names)
    assert not [place for place in places if ".." in place or max(map(len, place)) > 120]
    assert _places("a/b c/d.hil.toml::d") == ["a", "b c"]
    assert _places("a/b.py::T::t[1,x]") == ["a", "b.py", "T", "t[1,x]"]
    (_, whole), (_, cut) = (_places(f"b.py::{'x' * letters}") for letters in (100, 101))
    assert whole == "x" * 100
    assert (cut[:100], len(cut)) == (whole, 108)
