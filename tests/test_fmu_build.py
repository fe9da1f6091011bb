"""Making the FMU: generated files, a deterministic archive, sources that stand alone, errors."""

import subprocess
import sys
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import pytest
from fmpy.validation import validate_fmu

import hil.plant.build
import plant_fmu
from plant_fmu import build, generate, variables
from tests.plant_testbed import FMU

STRICT = ["-std=c11", "-O1", "-g", "-Wall", "-Wextra", "-Wconversion", "-Wpedantic", "-Werror"]
SANITIZE = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]


def test_generated_files_are_fresh() -> None:
    assert [path.name for path in generate.stale()] == []


def test_a_stale_file_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    text = (generate.HERE / "variables.toml").read_text(encoding="utf-8")
    changed = tmp_path / "variables.toml"
    changed.write_text(text.replace("start = 20.0", "start = 21.0"), encoding="utf-8")
    stale = generate.stale(variables.read(changed))
    assert {path.name for path in stale} == {
        "modelDescription.xml",
        "mecanum_variables.h",
        "README.md",
        "index.html",
    }
    monkeypatch.setattr(generate, "stale", lambda: stale)
    with pytest.raises(build.BuildError, match=r"modelDescription\.xml is stale; run python -m plant_fmu\.generate"):
        build.build(tmp_path / "x.fmu")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('name = "mass_kg"', 'name = "inertia_kg_m2"', "'inertia_kg_m2' is defined twice"),
        ('unit = "kg"', 'unit = "lb"', r"mass_kg: unit 'lb' is not in \[units\]"),
        ("start = 20.0\n", "", "mass_kg: an input or a parameter needs a start value"),
        (
            'name = "mass_kg"\ncausality = "parameter"',
            'name = "mass_kg"\ncausality = "local"',
            "causality 'local'",
        ),
        ('depends_on = "wheel.*', 'depends_on = "motor.*', r"unknown 'motor\.fl\.torque_n_m'"),
    ],
)
def test_a_wrong_definition_is_refused(tmp_path: Path, old: str, new: str, words: str) -> None:
    text = (generate.HERE / "variables.toml").read_text(encoding="utf-8")
    assert text.count(old) == 1
    path = tmp_path / "variables.toml"
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(variables.DefinitionError, match=words):
        variables.read(path)


def test_the_validator_has_nothing_to_say() -> None:
    assert validate_fmu(str(FMU)) == []


def test_the_archive_depends_on_its_inputs_alone(tmp_path: Path) -> None:
    one, two = build.build(tmp_path / "one.fmu"), build.build(tmp_path / "two.fmu")
    assert one.read_bytes() == two.read_bytes() == FMU.read_bytes()
    with zipfile.ZipFile(one) as archive:
        assert all(entry.date_time == (1980, 1, 1, 0, 0, 0) for entry in archive.infolist())


def test_an_up_to_date_fmu_is_left_alone(tmp_path: Path) -> None:
    out = build.build(tmp_path / "one.fmu")
    before = out.stat()
    build.build(out)
    assert (out.stat().st_ino, out.stat().st_mtime_ns) == (before.st_ino, before.st_mtime_ns)
    out.write_bytes(b"")
    assert zipfile.is_zipfile(build.build(out))


def test_the_archive_has_what_a_user_needs() -> None:
    with zipfile.ZipFile(FMU) as archive:
        names = set(archive.namelist())
        root = ET.fromstring(archive.read("modelDescription.xml"))
        licence = archive.read("documentation/licenses/license.txt")
    assert {"modelDescription.xml", "documentation/index.html", "sources/buildDescription.xml"} <= names
    listed = {file.get("name") for file in root.findall("CoSimulation/SourceFiles/File")}
    assert listed == {Path(name).name for name in names if name.endswith(".c")}
    assert licence == (plant_fmu.path().parents[1] / "LICENSE").read_bytes()


def test_the_packed_sources_and_the_shim_pass_the_sanitizers(tmp_path: Path) -> None:
    """What is in sources/ is complete, compiles without a warning, and does nothing undefined."""
    with zipfile.ZipFile(FMU) as archive:
        archive.extractall(tmp_path)
    sources = [*(tmp_path / "sources").glob("*.c"), *hil.plant.build.SOURCES]
    include = [tmp_path / "sources", *(header.parent for header in hil.plant.build.HEADERS)]
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


def test_without_a_compiler_one_sentence_says_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(build.BuildError, match=r"^no C compiler found \(tried cc, gcc, clang\); install one.*CC$"):
        build.build(tmp_path / "x.fmu")
    with pytest.raises(build.BuildError, match=r"tried nowhere-cc"):
        build.build(tmp_path / "x.fmu", cc="nowhere-cc -O2")


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


def test_as_a_program(tmp_path: Path) -> None:
    out = tmp_path / "x.fmu"
    command = [sys.executable, "-m", "plant_fmu.build", "--out", str(out)]
    done = subprocess.run(command, cwd=plant_fmu.path().parents[1], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(out)
    check = [sys.executable, "-m", "plant_fmu.generate", "--check"]
    subprocess.run(check, cwd=plant_fmu.path().parents[1], check=True)
