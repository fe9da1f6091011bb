"""What FMI 3.0 has and 2.0 has not: every function exported, typed enumerations, the logger, steps' outputs, XML."""

import ctypes
import re
import subprocess
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import fmpy
import pytest
from fmpy.fmi3 import (
    FMU3Model,
    FMU3ScheduledExecution,
    FMU3Slave,
    fmi3IntermediateUpdateCallback,
    fmi3LogMessageCallback,
)
from fmpy.validation import validate_fmu
from lxml import etree

import plant_fmu
from plant_fmu import generate
from plant_fmu.sources import SOURCE_FILES
from tests.support.fmu_slave import (
    DESCRIPTIONS,
    FMUS,
    TORQUES,
    VARIABLES,
    VERSIONS,
    Slave,
    discarded,
    fmpy_slave,
    refused,
    slave,
)
from tools.build import fmu as build

HEADERS = Path(fmpy.__file__).parent / "c-code"
SCHEMAS = Path(fmpy.__file__).parent / "schema"
SOURCES = plant_fmu.path().parent
REFERENCE = {name: variable.valueReference for name, variable in VARIABLES[3].items()}
ERROR = 3  # fmi3Error

FUNCTIONS = re.findall(r"fmi3FullName\((fmi3\w+)\)", (HEADERS / "fmi3Functions.h").read_text(encoding="utf-8"))
_TYPED = {"Float64", "Int32", "Int64"}
CLAIMED = {
    *(f"fmi3{verb}{kind}" for verb in ("Get", "Set") for kind in _TYPED),
    *(f"fmi3{verb}FMUState" for verb in ("Get", "Set", "Free", "Serialize", "Deserialize")),
    *("fmi3SerializedFMUStateSize", "fmi3GetVersion", "fmi3SetDebugLogging", "fmi3FreeInstance"),
    *("fmi3EnterInitializationMode", "fmi3ExitInitializationMode", "fmi3Terminate", "fmi3Reset", "fmi3DoStep"),
}
UNCLAIMED = sorted(name for name in FUNCTIONS if name not in CLAIMED and "Instantiate" not in name)


def test_every_function_of_the_standard_is_exported() -> None:
    assert len(FUNCTIONS) == 75
    library = fmpy_slave(3).dll
    assert [name for name in FUNCTIONS if not hasattr(library, name)] == []


def test_nothing_but_the_functions_of_the_two_standards_is_exported() -> None:
    library = fmpy_slave(3).dll
    assert not any(hasattr(library, name) for name in ("plant_step", "plant_save", "fmi3_legal", "mecanum_step"))


@pytest.mark.parametrize(
    ("source", "header"),
    [
        ("fmi2.c", "fmi2Functions.h"),
        ("fmi2_unclaimed.c", "fmi2Functions.h"),
        ("fmi3.c", "fmi3Functions.h"),
        ("fmi3_unclaimed.c", "fmi3Functions.h"),
    ],
)
def test_types_and_functions_are_those_of_the_headers_that_fmpy_ships(source: str, header: str) -> None:
    """The sources compile against the standard's headers in place of ours: all that they declare agrees."""
    ours = {"fmi2Functions.h": "FMI2_H", "fmi3Functions.h": "FMI3_H"}[header]
    command = [*build.compiler(), "-std=c11", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", f"-D{ours}"]
    command += ["-include", str(HEADERS / header), f"-I{SOURCES}", f"-I{generate.GENERATED}", str(SOURCES / source)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_sources_take_the_prefix_of_the_standard() -> None:
    def names(*defines: str) -> set[str]:
        command = [*build.compiler(), "-E", *defines, f"-I{SOURCES}", f"-I{generate.GENERATED}"]
        text = subprocess.run([*command, str(SOURCES / "fmi3.c")], capture_output=True, text=True, check=True).stdout
        return set(re.findall(r"\w*fmi3DoStep(?=\()", text))

    assert names() == {"fmi3DoStep"}
    assert names("-DFMI3_FUNCTION_PREFIX=mecanum_") == {"mecanum_fmi3DoStep"}
    assert names("-DFMI3_FUNCTION_PREFIX=mecanum_", "-DFMI3_OVERRIDE_FUNCTION_PREFIX") == {"fmi3DoStep"}
    override = ("-DFMI3_OVERRIDE_FUNCTION_PREFIX", "-DFMI3_ACTUAL_FUNCTION_PREFIX=my_")
    assert names("-DFMI3_FUNCTION_PREFIX=mecanum_", *override) == {"my_fmi3DoStep"}


def test_a_life_passes_the_sanitizers(tmp_path: Path) -> None:
    program = tmp_path / "driver"
    command = [*build.compiler(), *build.FLAGS, "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    command += [f"-I{folder}" for folder in (SOURCES, generate.GENERATED, HEADERS)]
    command += [str(Path(__file__).with_name("fmi3_driver.c")), *(str(SOURCES / n) for n in SOURCE_FILES)]
    compiled = subprocess.run([*command, "-o", str(program), "-lm"], capture_output=True, text=True, check=False)
    assert compiled.returncode == 0, compiled.stderr
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", UNCLAIMED)
def test_what_is_not_claimed_is_an_error_that_names_itself(name: str) -> None:
    """Every argument is 1: a count of one, or a pointer that no such function follows."""
    with slave(3) as fmu:
        function = getattr(ctypes.CDLL(fmu.raw.dll._name), name)  # without the types that FMPy gives to its own
        status = function(ctypes.c_void_p(fmu.raw.component), *([ctypes.c_size_t(1)] * 12))
        assert status == ERROR
        ((severity, category, message),) = fmu.log
        assert (severity, category) == (ERROR, "logStatusError")
        assert message.startswith(f"{name}: ")
        refused(fmu.step)


@pytest.mark.parametrize("kind", [FMU3Model, FMU3ScheduledExecution])
def test_the_fmu_is_for_co_simulation_only(kind: type[FMU3Slave]) -> None:
    heard: list[bytes] = []
    part = fmpy_slave(3)
    other = kind(guid=part.guid, unzipDirectory=part.unzipDirectory, modelIdentifier="mecanum", instanceName="x")
    with pytest.raises(Exception, match="Failed to instantiate"):
        other.instantiate(logMessage=lambda _environment, _status, _category, message: heard.append(message))
    assert heard == [b"instantiate: this FMU is for co-simulation only"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"token": "{0}"}, "wrong instantiation token"),
        ({"name": " \t"}, "the instance name is empty"),
        ({"eventModeUsed": True}, "no event mode"),
        ({"requiredIntermediateVariables": [REFERENCE["pose.x_m"]]}, "intermediate variables"),
    ],
)
def test_a_refused_instance_says_why_though_logging_is_off(changes: dict[str, object], words: str) -> None:
    heard: list[str] = []
    names = {key: str(changes.pop(key)) for key in ("token", "name") if key in changes}
    fmu = fmpy_slave(3, **names)
    with pytest.raises(Exception, match="Failed to instantiate"):
        fmu.instantiate(logMessage=lambda _e, _s, _c, message: heard.append(message.decode()), **changes)
    (message,) = heard
    assert words in message


def test_the_reason_of_an_error_is_logged_when_logging_is_on_and_not_when_it_is_off() -> None:
    with slave(3) as fmu:
        refused(fmu.raw.enterInitializationMode)
        sentence = 'fmi3EnterInitializationMode is not allowed in the state "step complete"'
        assert fmu.log == [(ERROR, "logStatusError", sentence)]
        fmu.raw.setDebugLogging(False, [])
        refused(fmu.step)
        assert len(fmu.log) == 1
        fmu.raw.setDebugLogging(True, [])
        refused(fmu.step)
        assert fmu.log[1][2] == 'fmi3DoStep is not allowed in the state "error"'


def test_no_logger_is_no_crash() -> None:
    fmu = fmpy_slave(3)
    nobody = fmi3LogMessageCallback(), fmi3IntermediateUpdateCallback()
    for token in (b"wrong", fmu.guid.encode()):
        component = fmu.fmi3InstantiateCoSimulation(
            b"x", token, None, False, True, False, False, None, 0, None, *nobody
        )
    refused(lambda: fmu.fmi3Terminate(component))
    fmu.fmi3FreeInstance(component)


def test_a_step_reports_no_event_no_end_no_early_return_and_its_time() -> None:
    with slave(3) as fmu:
        assert fmu.raw.doStep(0.0, 1e-3) == (False, False, False, 1e-3)
        assert fmu.raw.doStep(1e-3, 0.5) == (False, False, False, 1e-3 + 0.5)


def test_a_step_that_fails_reports_the_time_that_was_reached() -> None:
    flags, reached_s = [ctypes.c_bool(True) for _ in range(3)], ctypes.c_double(-1.0)
    with slave(3) as fmu:
        fmu.step(0.25)
        outputs = [ctypes.byref(flag) for flag in flags]
        refused(lambda: fmu.raw.fmi3DoStep(fmu.raw.component, 0.25, -1.0, True, *outputs, ctypes.byref(reached_s)))
    assert reached_s.value == 0.25
    assert [flag.value for flag in flags] == [False] * 3


@pytest.mark.parametrize("count", [0, 2])
@pytest.mark.parametrize(
    ("kind", "number", "name"),
    [("Float64", ctypes.c_double, TORQUES[0]), ("Int32", ctypes.c_int32, "seed"), ("Int64", ctypes.c_int64, "contact")],
)
def test_the_number_of_values_is_checked(kind: str, number: type, name: str, count: int) -> None:
    for verb in ("Get", "Set"):
        with slave(3, initialized=False) as fmu:
            call, values = getattr(fmu.raw, f"fmi3{verb}{kind}"), (number * 2)(1, 1)
            reference = ctypes.c_uint(REFERENCE[name])
            refused(lambda: call(fmu.raw.component, ctypes.byref(reference), 1, values, count))  # noqa: B023
            assert fmu.log[0][2] == f"fmi3{verb}{kind}: {count} values; expected 1, one for each variable"


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("an enumeration read as Int32", lambda f: f.raw.getInt32([REFERENCE["contact"]])),
        ("an enumeration set as Int32", lambda f: f.raw.setInt32([REFERENCE["contact"]], [1])),
        ("an integer read as Int64", lambda f: f.raw.getInt64([REFERENCE["seed"]])),
        ("an integer set as Int64", lambda f: f.raw.setInt64([REFERENCE["seed"]], [1])),
        ("a Float64 read as Float32", lambda f: f.raw.getFloat32([REFERENCE["mass_kg"]])),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_wrong_type_is_refused(name: str, call: Callable[[Slave], object]) -> None:
    with slave(3, initialized=False) as fmu:
        refused(lambda: call(fmu))


def test_an_item_that_does_not_fit_into_32_bits_is_discarded() -> None:
    with slave(3, initialized=False) as fmu:
        discarded(lambda: fmu.raw.setInt64([REFERENCE["contact"]], [2**32 + 1]))


def test_before_initialization_only_start_values_can_be_read() -> None:
    with slave(3, initialized=False) as fmu:
        assert fmu.get(["mass_kg", "drive", "counts_per_revolution", TORQUES[0]]) == [20.0, 1, 4096, 0.0]
        fmu.set({"mass_kg": 5.0})
        assert fmu.get(["mass_kg"]) == [5.0]
        refused(lambda: fmu.get(["time"]))
        assert fmu.log[0][2] == "get: time has no value before initialization"


@pytest.mark.parametrize("fmi", VERSIONS)
def test_the_validator_has_nothing_to_say(fmi: int) -> None:
    assert validate_fmu(str(FMUS[fmi])) == []


@pytest.mark.parametrize(
    ("document", "schema"),
    [
        ("fmi2/modelDescription.xml", "fmi2/fmi2ModelDescription.xsd"),
        ("fmi3/modelDescription.xml", "fmi3/fmi3ModelDescription.xsd"),
        ("fmi3/terminalsAndIcons.xml", "fmi3/fmi3TerminalsAndIcons.xsd"),
    ],
)
def test_the_documents_follow_the_schemas_of_the_standard(document: str, schema: str) -> None:
    rules = etree.XMLSchema(etree.parse(str(SCHEMAS / schema)))
    rules.assertValid(etree.parse(str(generate.GENERATED / document)))


def test_every_wheel_is_a_terminal_with_all_its_inputs_and_outputs() -> None:
    root = ET.parse(generate.GENERATED / "fmi3" / "terminalsAndIcons.xml").getroot()
    found = {
        (terminal.get("name"), member.get("memberName"), member.get("variableName"), member.get("variableKind"))
        for terminal in root.iter("Terminal")
        for member in terminal.iter("TerminalMemberVariable")
    }
    wanted = {
        (name[:8], name[9:], name, "signal")
        for name, variable in VARIABLES[3].items()
        if name.startswith("wheel.") and variable.causality in ("input", "output")
    }
    assert found == wanted
    assert len(found) == 4 * 11


def test_the_description_says_who_made_it_and_under_which_licence() -> None:
    for description in DESCRIPTIONS.values():
        assert (description.author, description.license) == ("The mecanum-hil authors", "MIT")
        assert (plant_fmu.path().parents[1] / "LICENSE").read_text(encoding="utf-8").count(description.copyright) == 1
