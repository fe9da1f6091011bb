"""Making the FMU: generated files, a deterministic archive, sources that stand alone, errors."""

import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import fmpy
import lief
import numpy as np
import pytest
from fmpy.validation import validate_fmu

import hil.plant.built
import plant_fmu
from plant_fmu import platforms
from plant_fmu.sources import DESCRIPTIONS, SOURCE_FILES
from tests.support.plant_testbed import FMU
from tools.build import compiler
from tools.build import fmu as build

STRICT = ["-std=c11", "-O1", "-g", "-Wall", "-Wextra", "-Wconversion", "-Wpedantic", "-Werror"]
SANITIZE = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
ROOT = plant_fmu.path().parents[1]
VERSIONS = sorted(DESCRIPTIONS)
SCRIPTS = sysconfig.get_path("scripts")  # of the virtual environment, where cmake is
needs_zig = pytest.mark.skipif(
    importlib.util.find_spec("ziglang") is None, reason=f"zig is not there: pip install {compiler.ZIG_REQUIREMENT}"
)


@pytest.mark.parametrize("fmi", VERSIONS)
def test_the_validator_has_nothing_to_say(fmi: int) -> None:
    assert validate_fmu(str(build.build(fmi=fmi))) == []


def test_an_up_to_date_fmu_is_left_alone(tmp_path: Path) -> None:
    out = Path(shutil.copy(build.build(), tmp_path / "one.fmu"))
    before = out.stat()
    build.build(out)
    assert (out.stat().st_ino, out.stat().st_mtime_ns) == (before.st_ino, before.st_mtime_ns)
    out.write_bytes(b"")
    assert zipfile.is_zipfile(build.build(out))


@pytest.mark.parametrize("fmi", VERSIONS)
def test_the_archive_has_what_a_user_needs(fmi: int) -> None:
    with zipfile.ZipFile(build.build(fmi=fmi)) as archive:
        names = set(archive.namelist())
        built = ET.fromstring(archive.read("sources/buildDescription.xml"))
        licence = archive.read("documentation/licenses/license.txt")
    assert {*DESCRIPTIONS[fmi], "documentation/index.html"} <= names
    sources = {Path(name).name for name in names if name.endswith(".c")}
    for configuration in built.findall("BuildConfiguration"):
        assert {file.get("name") for file in configuration.findall("SourceFileSet/SourceFile")} == sources
    assert licence == (ROOT / "LICENSE").read_bytes()


def test_fmi_2_lists_its_sources_in_its_description_too() -> None:
    root = ET.parse(DESCRIPTIONS[2]["modelDescription.xml"]).getroot()
    listed = [file.get("name") for file in root.findall("CoSimulation/SourceFiles/File")]
    assert listed == list(SOURCE_FILES)


def exports(fmu: Path, fmi: int) -> set[str]:
    """Return what the library of this machine exports, but for the linker's own marks."""
    here = platforms.this_platform()
    folder = platforms.word_size_name(here) if fmi == 2 else here
    with zipfile.ZipFile(fmu) as archive:
        libraries = [name for name in archive.namelist() if name.endswith(platforms.suffix(here))]
        (name,) = (name for name in libraries if name.startswith(f"binaries/{folder}/"))
        binary = lief.parse(list(archive.read(name)))
    assert isinstance(binary, lief.Binary)
    names = {str(function.name).removeprefix("_") for function in binary.abstract.exported_functions}
    return names - {"mh_dylib_header", "_dso_handle", "init", "fini"}


@pytest.mark.skipif(not (shutil.which("cmake", path=SCRIPTS) or shutil.which("cmake")), reason="pip install cmake")
@pytest.mark.parametrize("fmi", VERSIONS)
def test_others_can_compile_the_sources(fmi: int, tmp_path: Path) -> None:
    """FMPy compiles an FMU without binaries by its build description, and the result computes the same as ours."""
    stripped = tmp_path / "plant.fmu"
    with zipfile.ZipFile(build.build(fmi=fmi)) as ours, zipfile.ZipFile(stripped, "w") as archive:
        for name in ours.namelist():
            if not name.startswith("binaries/"):
                archive.writestr(name, ours.read(name))
    assert fmpy.supported_platforms(str(stripped)) == ["c-code"]
    environment = {
        **os.environ,
        "PATH": os.pathsep.join([SCRIPTS, os.environ["PATH"]]),
        "CC": shlex.join(build.compiler()),
    }
    command = [sys.executable, "-m", "fmpy", "compile", str(stripped)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(fmpy.supported_platforms(str(stripped))) == 2, done.stdout + done.stderr
    start = {"wheel.fl.torque_n_m": 1.0, "wheel.rr.torque_n_m": -0.5, "start_vx_m_s": 0.5}
    exported = exports(stripped, fmi)
    assert exported == {name for name in exported if name.startswith(("fmi2", "fmi3"))} != set()
    theirs, ours = (
        fmpy.simulate_fmu(str(path), stop_time=0.2, start_values=start) for path in (stripped, build.build(fmi=fmi))
    )
    assert theirs.dtype == ours.dtype
    assert theirs["pose.x_m"][-1] > 0.05
    for name in theirs.dtype.names:
        np.testing.assert_allclose(theirs[name], ours[name], rtol=1e-9, atol=1e-12, err_msg=name)


@pytest.mark.skipif(compiler.wants_zig(), reason="zig has no address sanitizer; install gcc or clang")
def test_the_packed_sources_and_the_shim_pass_the_sanitizers(tmp_path: Path) -> None:
    """What is in sources/ is complete, compiles without a warning, and does nothing undefined."""
    with zipfile.ZipFile(FMU) as archive:
        archive.extractall(tmp_path)
    sources = [*(tmp_path / "sources").glob("*.c"), *hil.plant.built.SOURCES]
    include = [tmp_path / "sources", *(header.parent for header in hil.plant.built.HEADERS)]
    program = tmp_path / "driver"
    command = [*build.compiler(), *STRICT, *SANITIZE, *(f"-I{folder}" for folder in include)]
    driver = Path(__file__).with_name("plant_driver.c")
    command += [*map(str, sources), str(driver), "-o", str(program), "-lm"]
    compiled = subprocess.run(command, capture_output=True, text=True, check=False)
    assert compiled.returncode == 0, compiled.stderr
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_sources_take_the_prefix_of_the_standard(tmp_path: Path) -> None:
    """Compiled into an importer, every function carries the model identifier (FMI 2.0 section 2.1.1)."""
    folder = plant_fmu.path().parent
    command = [*build.compiler(), *build.FLAGS, "-DFMI2_FUNCTION_PREFIX=mecanum_", f"-I{folder}"]
    command += [f"-I{folder / 'generated'}", "-E", str(folder / "fmi2.c")]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "mecanum_fmi2DoStep(" in text
    assert " fmi2DoStep(" not in text


@pytest.fixture
def bare(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Take every C compiler off the PATH."""
    (tmp_path / "empty").mkdir()
    monkeypatch.setenv("PATH", str(tmp_path / "empty"))
    monkeypatch.delenv("CC", raising=False)


@pytest.mark.usefixtures("bare")
def test_without_a_compiler_and_zig_one_sentence_says_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert compiler.wants_zig()
    monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
    with pytest.raises(build.BuildError, match=r"^no C compiler found \(tried cc, gcc, clang and zig\); .* or set CC$"):
        build.build(tmp_path / "x.fmu")
    with pytest.raises(build.BuildError, match=r"^zig is not installed.*; run pip install ziglang==[\d.]+$"):
        build.build(tmp_path / "x.fmu", all_platforms=True)
    with pytest.raises(build.BuildError, match=r"the C compiler 'nowhere-cc' \(from CC\) is not there; set CC"):
        build.build(tmp_path / "x.fmu", cc="nowhere-cc -O2")


@needs_zig
@pytest.mark.usefixtures("bare")
def test_without_a_compiler_zig_builds_what_runs_here(tmp_path: Path) -> None:
    assert "ziglang" in build.compiler()
    made = build.build(tmp_path / "zig.fmu")
    results = fmpy.simulate_fmu(str(made), stop_time=0.1, start_values={"wheel.fl.torque_n_m": 1.0})
    assert results["twist.vx_m_s"][-1] > 0


def test_cc_comes_before_all_else(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", f"{sys.executable} -m ziglang cc")
    assert build.compiler() == [sys.executable, "-m", "ziglang", "cc"]
    assert not compiler.wants_zig()


def test_the_tests_and_the_wheel_use_the_same_zig() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert compiler.ZIG_REQUIREMENT in project["optional-dependencies"]["dev"]


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(build.BuildError, match=r"file/x\.fmu: cannot be written"):
        build.build(tmp_path / "file" / "x.fmu")


def test_a_compiler_that_fails_is_quoted(tmp_path: Path) -> None:
    broken = tmp_path / "broken.c"
    broken.write_text("int f(void) { return missing; }\n")
    with pytest.raises(build.BuildError, match="missing"):
        build.compile_shared([broken], tmp_path / "libbroken.so")
    assert list(tmp_path.glob("lib*")) == []


def test_the_program_makes_archives_that_depend_on_their_inputs_alone(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tools.build.fmu", "--out", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [str(tmp_path / plant_fmu.path(fmi).name) for fmi in VERSIONS]
    for fmi in VERSIONS:
        made = tmp_path / plant_fmu.path(fmi).name
        assert made.read_bytes() == build.build(fmi=fmi).read_bytes()  # of another time, in another folder
        with zipfile.ZipFile(made) as archive:
            assert all(entry.date_time == (1980, 1, 1, 0, 0, 0) for entry in archive.infolist())
    nowhere = [sys.executable, "-m", "tools.build.fmu", "--all-platforms"]
    refused = subprocess.run(nowhere, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (refused.returncode, "--out FOLDER" in refused.stderr) == (2, True)
    check = [sys.executable, "-m", "plant_fmu.generate", "--check"]
    subprocess.run(check, cwd=ROOT, check=True)
