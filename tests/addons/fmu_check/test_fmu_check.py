"""``check`` finds nothing in good FMUs, and each fault of a broken one in its part and of its kind."""

import functools
import math
import re
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace

import pytest
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from hypothesis import given
from hypothesis import strategies as st

from hil.addons.fmu_check import Kind
from hil.addons.fmu_check import __main__ as child
from hil.addons.fmu_check import check as checker
from hil.addons.fmu_check.__main__ import run_parts
from hil.addons.fmu_check.check import CheckResult, _Progress, check
from hil.addons.fmu_check.parts import PARTS, title
from hil.addons.fmu_check.slave import Model, Slave, close
from hil.core.errors import BadInputError
from hil.plant import archive
from hil.plant.fmu import FmuPlant
from tests.support import broken_fmu
from tests.support.broken_fmu import HEADERS, Change, lag, pack
from tests.support.plant_testbed import FMU
from tests.support.processes import ROOT, environment, is_running, wait_for
from tools.build.compiler import compile_shared

# Every fault of lag.h: the part that has to find it, and words of the problem.
FAULTS = {
    "CRASH_WHEN_LOADED": ("functions", "while its library is loaded, its process was ended by SIGABRT"),
    "CRASH_IN_GET_VERSION": ("version", "GetVersion, its process was ended by SIGABRT"),
    "WRONG_VERSION": ("version", "GetVersion gives '1.9'"),
    "NO_INSTANCE": ("life cycle", "returns no instance"),
    "CRASH_IN_STEP": ("life cycle", "DoStep, its process was ended by SIGABRT (Aborted)"),
    "CHATTY_CRASH": ("life cycle", "(Aborted); its last words: 'the last word'"),
    "RUDE_CRASH": ("life cycle", "(Aborted); its last words: '[31mred 2J'"),
    "REAL_TIME_SIGNAL": ("life cycle", "DoStep, its process was ended by signal 40 (Real-time signal 6)"),
    "EXIT_IN_STEP": ("life cycle", "DoStep, its process exited with code 0"),
    "HANG_IN_STEP": ("life cycle", "DoStep, it gave no answer within 1 s and was ended"),
    "FORKED_CRASH": ("life cycle", "DoStep, its process was ended by SIGABRT (Aborted)"),
    "FATAL_IN_STEP": ("life cycle", "DoStep returns fatal (the lag says no, for once)"),
    "BYTES_IN_PIPES": ("life cycle", "DoStep, it wrote into the pipe of its process: '\\x1b[31mno record'"),
    "NO_DEBUG_LOGGING": ("debug logging", "SetDebugLogging returns error (the lag says no, for once)"),
    "ERROR_IN_STEP": ("life cycle", "DoStep returns error (the lag says no, for once)"),
    "WRONG_START": ("start values", "gain reads 3.0 at the start; modelDescription.xml says 2.0"),
    "LOST_INPUT": ("variables", "input u reads -0.1 after it was set to -0.2"),
    "NOT_A_NUMBER": (
        "variables",
        "output y is nan after 11 steps; a run of this importer ends where one is not finite",
    ),
    "STALE_OUTPUT": ("initialization", "output y is -0.4 after inputs were set twice; set once, they give -0.2"),
    "LATE_CLOCK": ("time", "the time time is 0.49 s; expected 0.5 s"),
    "WRONG_LAST_TIME": ("time", "doStep to 0.51 s gives the last successful time 0.5 s"),
    "ENDS_SIMULATION": ("time", "asks to end the simulation"),
    "RETURNS_EARLY": ("time", "returns early, which was not agreed on"),
    "ASKS_FOR_EVENT_MODE": ("time", "asks for event mode, which was not agreed on"),
    "FIXED_STEP": ("step size", "20 steps of half the size bring the outputs as far as 20 whole ones"),
    "REFUSED_STEP": ("step size", "DoStep returns error"),
    "DISCARDED_STEP": ("step size", "a step of 0.03 s is not done: fmi"),
    "DISCARDED_STEPS": ("life cycle", "DoStep returns discard"),
    "STATE_REFUSED": ("saved state", "returns error"),
    "STATE_LOST": ("saved state", "a restored state gives other outputs than when it was saved"),
    "STATE_NOT_REUSED": ("saved state", "a state that was saved over an older one gives other outputs"),
    "BYTES_TOO_LONG": ("saved state", "writes past the"),
    "BYTES_LOST": ("saved state", "a state from bytes, in another instance, gives other outputs"),
    "SILENT_AFTER_TERMINATE": ("termination", "returns error"),
    "RESET_KEEPS_STATE": ("reset", "after reset the same inputs give other outputs"),
    "RESET_KEEPS_INPUT": ("reset", "after reset u is 0.2; it was 0.0 in the new instance"),
    "SHARED_STATE": ("two instances", "an instance does not start where it should after another was stepped"),
    "CRASH_AT_THE_END": ("two instances", "at its exit, its process was ended by SIGABRT"),
}
NEEDS = {"NOT_A_NUMBER", "DISCARDED_STEP", "WRONG_LAST_TIME", "ENDS_SIMULATION", "DISCARDED_STEPS"}
FMI_3_ONLY = {"WRONG_LAST_TIME", "ENDS_SIMULATION", "RETURNS_EARLY", "ASKS_FOR_EVENT_MODE"}
NOT_HERE = set() if sys.platform == "linux" else {"REAL_TIME_SIGNAL", "FORKED_CRASH", "BYTES_IN_PIPES"}
CASES = [
    (fmi, fault)
    for fmi, others in ((2, FMI_3_ONLY | NOT_HERE), (3, NOT_HERE))
    for fault in FAULTS
    if fault not in others
]


def kind_of(fault: str) -> Kind:
    """Return what the standard makes of a fault."""
    return Kind.NEED if fault in NEEDS else Kind.VIOLATION


def found(result: CheckResult) -> list[str]:
    """Return all that was found, but for notes."""
    return [words for kind in Kind if kind != Kind.NOTE for words in result.texts(kind)]


def test_nothing_is_found_in_the_shipped_fmu() -> None:
    assert found(check(FMU)) == []


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_good_fmu_passes_every_part(fmi: int, tmp_path: Path) -> None:
    result = check(lag(tmp_path, fmi))
    assert [(part.name, part.skipped) for part in result.parts] == [
        (name, None) for name in ("archive", "model description", *map(title, PARTS))
    ]
    assert found(result) == []
    (told,) = result.texts(Kind.NOTE)
    assert told.startswith("bridge step: stepped by the tick of 0.001 s, which it claims to handle")


NEEDS_A_CHILD = re.compile(
    "CRASH|REAL_TIME_SIGNAL|EXIT_IN|HANG|FATAL|BYTES_IN_PIPES"
)  # faults that end a process, or fill it


def run_here(fmu: Path, parts: Sequence[str] = tuple(map(title, PARTS))) -> CheckResult:
    """Run parts of ``check`` in this process: those that need no process of their own."""
    progress = _Progress()
    with archive.extract(fmu) as folder:
        library = archive.library_of(fmu)
        model = Model(fmu, folder, folder / library.member, library.fmi_version, lambda **entry: progress.add(entry))
        run_parts(model, parts, model.report)
    return CheckResult(tuple(progress.parts))


def assert_found(fault: str, result: CheckResult) -> None:
    """Assert that a fault is found by its part alone, and is of its kind."""
    part, words = FAULTS[fault]
    told = result.texts(kind_of(fault))
    assert any(words in one for one in told), found(result)
    assert found(result) == told
    assert {one.split(":")[0] for one in told} == {part}


@pytest.mark.parametrize(("fmi", "fault"), [case for case in CASES if NEEDS_A_CHILD.search(case[1])])
def test_a_fault_is_found_by_its_part_and_is_of_its_kind(fmi: int, fault: str, tmp_path: Path) -> None:
    fmu = lag(tmp_path, fmi, fault)
    result = check(fmu, longest_s=1.0) if fault == "HANG_IN_STEP" else check(fmu)
    assert [p.name for p in result.parts[2:]] == [title(p) for p in PARTS]
    assert_found(fault, result)


@pytest.mark.parametrize(("fmi", "fault"), [case for case in CASES if not NEEDS_A_CHILD.search(case[1])])
def test_a_fault_that_leaves_the_process_alone_is_found_too(fmi: int, fault: str, tmp_path: Path) -> None:
    assert_found(fault, run_here(lag(tmp_path, fmi, fault)))


def test_without_inputs_no_output_can_follow_them(tmp_path: Path) -> None:
    fmu = lag(tmp_path, 2, "STALE_OUTPUT", text('causality="input"', 'causality="local"'))
    (part,) = run_here(fmu, ["initialization"]).parts
    assert (part.findings, part.skipped) == ((), "there are no floating-point inputs")


def test_each_step_begins_where_the_one_before_ended_and_has_inputs_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[tuple[str, float, float]] = []
    step, drive = Slave.step, Slave.drive
    monkeypatch.setattr(Slave, "step", lambda *at: (done.append(("step", *at[1:])), step(*at))[1])
    monkeypatch.setattr(Slave, "drive", lambda *at: (done.append(("drive", *at[1:], 0.0)), drive(*at))[1])
    fixed = lag(tmp_path, 2, change=text('canHandleVariableCommunicationStepSize="true"', ""))
    any_size = lag(tmp_path, 3)

    def steps(fmu: Path, part: str, *, driven: bool = False) -> list[float]:
        done.clear()
        run_here(fmu, [part])
        assert not driven or [row[1] for row in done if row[0] == "drive"] == [*range(20)]
        return [value for name, *values in done if name == "step" for value in values]

    once = [value for number in range(20) for value in (0.5 + 0.01 * number, 0.01)]
    assert steps(fixed, "bridge step", driven=True) == pytest.approx(once)
    assert steps(any_size, "bridge step") == []
    assert steps(any_size, "variables", driven=True) == pytest.approx(once)
    assert steps(any_size, "termination", driven=True) == pytest.approx(once)
    assert steps(any_size, "life cycle") == pytest.approx(2 * once)
    assert steps(any_size, "time") == pytest.approx([*once, 0.7, 0.01])
    assert steps(any_size, "debug logging") == [0.5, 0.01]
    sizes_s = [0.01, 0.005, 0.03, 0.001, 0.017, 0.001]
    various = [value for number, size_s in enumerate(sizes_s) for value in (0.5 + sum(sizes_s[:number]), size_s)]
    half = [value for number in range(20) for value in (0.5 + 0.005 * number, 0.005)]
    assert steps(any_size, "step size") == pytest.approx([*various, *once[:20], *once, *half])


def test_the_child_works_in_the_library_s_folder_and_says_what_it_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some libraries look for others in the working directory."""
    fmu, said = lag(tmp_path, 2, "WRONG_VERSION"), list[dict[str, object]]()
    with archive.extract(fmu) as folder:
        library = folder / archive.library_of(fmu).member
        job = {"fmu": str(fmu), "library": str(library), "version": "2.0", "parts": ["version", "reset"]}
        parent = SimpleNamespace(scratch=folder, receive=lambda: job, send=lambda **entry: said.append(entry))
        monkeypatch.setattr(child, "Parent", lambda: parent)
        monkeypatch.chdir(tmp_path)
        child.main()
        assert Path.cwd() == library.parent
        monkeypatch.chdir(tmp_path)
    assert [entry["part"] for entry in said if "part" in entry] == ["version", "reset"]
    (wrong,) = (entry for entry in said if "found" in entry)
    assert wrong == {"kind": "violation", "found": "fmi2GetVersion gives '1.9'; expected 2.0"}
    assert [entry for entry in said if "doing" in entry][-1] == said[-1] == {"doing": "at its exit"}
    assert said.count({"done": True}) == 2


def test_a_call_may_last_as_long_as_is_given_once_the_first_part_has_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And until then a minute, for our own modules; each record of the child is a new call."""
    watched: list[tuple[float, object]] = []
    rows = [{"here": True}, {"part": "functions"}, {"doing": "in f"}, {"done": True}, {"doing": "at its exit"}]
    told: list[str] = []
    watch: SimpleNamespace
    ended, memory_mb = list[float](), list[float]()

    def made_watch(pending: object, expire: object, limit_s: float, look: Callable[[], object]) -> SimpleNamespace:
        nonlocal watch
        watch = SimpleNamespace(pending=pending, limit_s=limit_s, stop=lambda: None)
        assert (expire, limit_s) == (process.give_up, 9.0)
        look()
        return watch

    def received() -> Iterator[dict[str, object]]:
        for row in rows:
            watched.append((watch.limit_s, watch.pending()))
            yield row

    process = SimpleNamespace(
        give_up=lambda _: None, limit_memory=memory_mb.append, close=ended.append, send=told.append,
        receive_all=received, wait=lambda: 0, ending=lambda: "it ended",
    )  # fmt: skip
    monkeypatch.setattr(checker, "ChildProcess", lambda *_: process)
    monkeypatch.setattr(checker, "Watch", made_watch)
    said: list[str] = []
    job = {"fmu": "a.fmu", "parts": ["functions"]}
    (part,) = checker._run_child(job, tmp_path, 9.0, said.append)
    assert watched == [(60.0, 0), (60.0, 1), (9.0, 2), (9.0, 3), (9.0, 4)]
    assert (told, said, ended, memory_mb) == ([job], ["functions"], [0.0], [2000.0])
    assert (part.name, part.findings) == ("functions", ())
    rows[-2:] = []
    (part,) = checker._run_child(job, tmp_path, 9.0, said.append)
    assert [one.text for one in part.findings] == ["in f, it ended"], "it did not get to its end"
    rows[:] = [{"refused": "needs more"}]
    with pytest.raises(BadInputError, match=r"^FMU a.fmu: needs more$"):
        checker._run_child(job, tmp_path, 9.0, said.append)


def test_each_part_is_announced_and_a_missing_library_of_ours_is_told_before_any(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    jobs: list[tuple[object, ...]] = []
    monkeypatch.setattr(checker, "_run", lambda job, _, *rest: (jobs.append((job["parts"], *rest)), [])[1])
    fmu = lag(tmp_path, 2)
    parts = check(fmu, 7.0, said.append).parts
    assert ([part.name for part in parts], said) == (["archive", "model description"], ["archive", "model description"])
    assert jobs == [([title(part) for part in PARTS], 7.0, said.append)]

    def missing() -> None:
        raise BadInputError("no compiler")

    monkeypatch.setattr("hil.plant.shim.load", missing)
    with pytest.raises(BadInputError, match="no compiler"):
        check(fmu, 7.0, said.append)
    assert (len(said), len(jobs)) == (2, 1)


def test_an_instance_is_freed_but_for_one_that_answered_fatal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []
    made = SimpleNamespace(initialise=lambda: calls.append("initialise"), call=calls.append)
    monkeypatch.setattr("hil.addons.fmu_check.slave.Slave", lambda _: made)
    model = Model(lag(tmp_path, 2), tmp_path, tmp_path / "none.so", "2.0", lambda **_: None)
    for initialised in (True, False):
        with model.instance(initialised=initialised) as slave:
            assert slave is made
    assert calls == ["initialise", "FreeInstance", "FreeInstance"]
    with model.instance():
        model.is_fatal = True
    assert calls[3:] == ["initialise"]


def test_a_part_steps_as_often_as_it_needs_to_be_sure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fmu, steps, step = lag(tmp_path, 2), Counter[str](), Slave.step
    for part in map(title, PARTS):
        count = functools.partial(steps.update, [part])
        monkeypatch.setattr(Slave, "step", lambda *at, count=count: (count(), step(*at))[1])
        run_here(fmu, [part])
    assert steps == {
        "life cycle": 40, "debug logging": 1, "variables": 20, "time": 21, "step size": 6 + 10 + 2 * 20,
        "saved state": 5 * 20, "termination": 20, "reset": 3 * 20, "two instances": 3 * 20,
    }  # fmt: skip


def test_every_fault_of_the_header_has_a_case() -> None:
    assert set(broken_fmu.FAULTS) - {"NO_FAULT", "SLOW_STEP", "ROUNDED_START"} == set(FAULTS)


def renamed(function: str) -> Change:
    """Take a function's name out of the library's table of symbols."""

    def change(name: str, data: bytes) -> bytes:
        if name.endswith(".xml"):
            return data
        assert f"\0{function}\0".encode() in data
        return data.replace(f"\0{function}\0".encode(), f"\0{function[:-1]}X\0".encode())

    return change


@pytest.mark.parametrize(
    ("fmi", "function"),
    [(2, "fmi2GetVersion"), (2, "fmi2CancelStep"), (2, "fmi2DoStep"), (3, "fmi3GetClock"), (3, "fmi3SetTime")],
)
def test_a_function_that_is_not_exported_is_named_and_nothing_else_is_run(
    fmi: int, function: str, tmp_path: Path
) -> None:
    result = check(lag(tmp_path, fmi, change=renamed(function)))
    assert found(result) == [f"functions: {function} is not exported"]
    after = result.parts[3:]
    assert [part.skipped for part in after] == ["not run, since functions failed"] * len(after)


def test_all_functions_of_the_standard_are_asked_for() -> None:
    """FMPy's classes, which give the names, agree with the standard's headers."""
    header = (HEADERS / "fmi3Functions.h").read_text(encoding="utf-8")
    assert set(re.findall(r"FMI3_Export (fmi3\w+)TYPE", header)) == {n for n in dir(FMU3Slave) if n.startswith("fmi3")}
    header = (HEADERS / "fmi2Functions.h").read_text(encoding="utf-8")
    declared = re.findall(r"FMI2_Export (fmi2\w+)TYPE", header)
    exchange = declared[declared.index("fmi2EnterEventMode") : declared.index("fmi2GetNominalsOfContinuousStates") + 1]
    assert set(declared) - set(exchange) == {n for n in dir(FMU2Slave) if n.startswith("fmi2")}


def text(old: str, new: str) -> Change:
    def change(name: str, data: bytes) -> bytes:
        if not name.endswith(".xml"):
            return data
        assert old.encode() in data
        return data.replace(old.encode(), new.encode())

    return change


DESCRIPTIONS = [
    (2, 'guid="{c0', 'guid="{c1', "life cycle: fmi2Instantiate returns no instance (another type or token)"),
    (3, 'Token="{c0', 'Token="{c1', "life cycle: fmi3InstantiateCoSimulation returns no instance (another token)"),
    (2, 'unit="s"', 'unit="lb"', 'model description: The unit "lb" of variable "time"'),
    (3, 'unit="s"', 'unit="lb"', 'model description: The unit "lb" of variable "time"'),
    (3, 'start="2" min', 'start="4" min', "start values: gain reads 2.0 at the start; modelDescription.xml says 4.0"),
    (2, 'gain" valueReference="2"', 'gain" valueReference="9"', "start values: fmi2GetReal returns error"),
    (3, '<Dimension start="2"', '<Dimension start="3"', "variables: fmi3GetFloat64 returns error"),
]


@pytest.mark.parametrize(("fmi", "old", "new", "words"), DESCRIPTIONS)
def test_a_description_that_does_not_fit_the_library_is_found(
    fmi: int, old: str, new: str, words: str, tmp_path: Path
) -> None:
    violations = check(lag(tmp_path, fmi, change=text(old, new))).violations
    assert any(violation.startswith(words) for violation in violations), violations


@pytest.mark.parametrize("fmi", [2, 3])
def test_what_is_not_claimed_is_not_tested(fmi: int, tmp_path: Path) -> None:
    """Faults in what an FMU does not claim are no faults."""
    state = "state" if fmi == 2 else "State"
    for fault, claim, part, why, needs in (
        ("STATE_LOST", f"canGetAndSetFMU{state}", "saved state", "saved states are not claimed", []),
        (
            "REFUSED_STEP",
            "canHandleVariableCommunicationStepSize",
            "step size",
            "variable communication step sizes are not claimed",
            ["bridge step: stepped by 0.01 s, 10"],
        ),
    ):
        result = check(lag(tmp_path, fmi, fault, text(f'{claim}="true"', "")))
        assert [one[:34] for one in found(result)] == needs
        assert result.violations == []
        assert [(p.name, p.skipped) for p in result.parts if p.skipped] == [(part, why)]


def test_without_a_variable_for_the_time_no_clock_is_tested(tmp_path: Path) -> None:
    unnamed = text('causality="independent"', 'causality="local"')
    (part,) = run_here(lag(tmp_path, 2, "LATE_CLOCK", unnamed), ["time"]).parts
    assert (part.findings, part.skipped) == ((), "no variable is the time")


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_step_that_only_a_run_does_and_the_fmu_discards_is_a_need(fmi: int, tmp_path: Path) -> None:
    fmu = lag(tmp_path, fmi, "DISCARDED_STEPS", text('canHandleVariableCommunicationStepSize="true"', ""))
    result = run_here(fmu, ["bridge step"])
    *_, told = found(result)
    assert told == f"bridge step: a step of 0.01 s, which a run does, is not done: fmi{fmi}DoStep returns discard"
    assert found(result) == result.texts(Kind.NEED)


@pytest.mark.parametrize(("fmi", "function"), [(2, "fmi2Instantiate"), (3, "fmi3InstantiateCoSimulation")])
def test_an_fmu_that_needs_its_tool_breaks_no_rule(fmi: int, function: str, tmp_path: Path) -> None:
    tool = text('modelIdentifier="lag"', 'modelIdentifier="lag" needsExecutionTool="true"')
    result = run_here(lag(tmp_path, fmi, "NO_INSTANCE", tool))
    (told,) = result.texts(Kind.NEED)
    assert told.startswith(f"life cycle: {function} returns no instance without its tool")
    assert result.violations == []


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_start_value_may_differ_by_rounding(fmi: int, tmp_path: Path) -> None:
    assert found(run_here(lag(tmp_path, fmi, "ROUNDED_START"))) == []


@given(st.floats(-1e300, 1e300), st.sampled_from([math.inf, -math.inf, 0.0]))
def test_rounding_is_no_difference_and_a_thousandth_is(value: float, towards: float) -> None:
    assert close([math.nextafter(value, towards)], [value]) or abs(value) < 1e-300
    assert not close([value * 1.001 + math.copysign(1e-9, value)], [value])
    assert not close([int(value) + 1], [int(value)])


@pytest.mark.skipif(sys.platform != "linux", reason="the words of glibc's loader")
def test_a_library_of_the_system_that_is_missing_is_named_and_no_fault_of_the_fmu(tmp_path: Path) -> None:
    """In a check as in a run: an FMU with its own library next to it can find it."""
    other = tmp_path / "libneeded_by_lag.so.3"
    source = tmp_path / "other.c"
    source.write_text("int other(void) { return 1; }\n")
    user = tmp_path / "user.c"
    user.write_text("int other(void);\nint fmi2GetVersion(void) { return other(); }\n")
    compile_shared([source], other, flags=("-Wl,-soname,libneeded_by_lag.so.3",))
    compile_shared([user], tmp_path / "lag.so", flags=("-Wl,--no-as-needed", str(other)))
    library = (tmp_path / "lag.so").read_bytes()
    name = f"binaries/{archive.binary_folders('2.0')[-1]}/{other.name}"
    words = "its library needs libneeded_by_lag.so.3, which the system does not find; install it"
    for added in ([], [(name, other.read_bytes())]):
        fmu = pack(tmp_path / "a.fmu", 2, added=added, library=library)
        for use in (check, lambda path: FmuPlant(path, {})):
            with pytest.raises(BadInputError, match=re.escape(words)):
                use(fmu)


@pytest.mark.parametrize(
    ("declared", "words"),
    [
        ('fixedInternalStepSize="0.005"', ["stepped by 0.005 s, 5 ticks"]),
        ('fixedInternalStepSize="0.0015"', ["FMU lag_fmi3.fmu: its communication step is 0.0015 s"]),
    ],
)
def test_a_step_that_is_not_the_bridges_is_a_need(declared: str, words: list[str], tmp_path: Path) -> None:
    claim = text('canHandleVariableCommunicationStepSize="true"', declared)
    result = run_here(lag(tmp_path, 3, change=claim))
    assert result.violations == []
    told = [one.removeprefix("bridge step: ").replace(f"{tmp_path}/", "") for one in result.texts(Kind.NEED)]
    assert [one[: len(expected)] for one, expected in zip(told, words, strict=True)] == words


def test_a_library_that_cannot_be_loaded_is_a_problem(tmp_path: Path) -> None:
    fmu = lag(tmp_path, 2, change=lambda name, data: data if name.endswith(".xml") else b"no library")
    (problem,) = check(fmu).violations
    assert problem.startswith("functions: the library cannot be loaded (")


def test_a_part_of_many_short_calls_is_no_hang(tmp_path: Path) -> None:
    """Together, the steps of a part take longer than one call may."""
    alone = text('modelIdentifier="lag"', 'modelIdentifier="lag" canBeInstantiatedOnlyOncePerProcess="true"')
    result = check(lag(tmp_path, 2, "SLOW_STEP", alone), longest_s=0.5)
    assert found(result) == []
    assert "saved state" in [part.name for part in result.parts if part.skipped is None]  # 120 steps of 8 ms


def test_a_file_in_the_users_folder_shadows_no_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("numpy.py", "json.py"):
        (tmp_path / name).write_text("raise SystemExit('a file of the user')\n")
    assert check(lag(tmp_path, 2)).violations == []


@pytest.mark.skipif(sys.platform == "win32", reason="signals need a POSIX system")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_check_that_is_ended_leaves_no_child_and_no_files(tmp_path: Path, number: signal.Signals) -> None:
    """Also while the FMU hangs."""
    fmu = lag(tmp_path, 2, "HANG_IN_STEP")
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    code = f"from pathlib import Path; from hil.addons.fmu_check.check import check; check(Path({str(fmu)!r}), 1000)"
    checking = subprocess.Popen(
        [sys.executable, "-c", code], env=environment() | {"TMPDIR": str(scratch)}, cwd=ROOT, stderr=subprocess.DEVNULL
    )
    try:
        wait_for(lambda: list(scratch.glob("*/binaries/*/hanging")))
        found = subprocess.run(["pgrep", "-P", str(checking.pid)], capture_output=True, text=True, check=True)
        (its_child,) = map(int, found.stdout.split())
        assert is_running(its_child)
        checking.send_signal(number)
        assert checking.wait() != 0
    finally:
        checking.kill()
    wait_for(lambda: not is_running(its_child))
    assert list(scratch.iterdir()) == []


def test_a_description_that_cannot_be_read_is_a_problem_and_nothing_is_run(tmp_path: Path) -> None:
    result = check(lag(tmp_path, 2, change=text('valueReference="1"', 'valueReference="one"')))
    archive, *_, last = result.parts
    assert "its modelDescription.xml cannot be used" in archive.findings[0].text
    assert last.skipped == "not run, since archive failed"
