"""What is made of variables.toml (description, c_header, manifest, tables), what it may not say, and the platforms."""

import dataclasses
import sys
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plant_fmu import generate, platforms, tables, variables
from plant_fmu.mujoco import definition
from tests.support.examples import share_of_examples
from tools.build.fmu import BuildError, build


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
        "index.html",
    }
    monkeypatch.setattr(generate, "stale", lambda: stale)
    with pytest.raises(BuildError, match=r"modelDescription\.xml is stale; run python -m plant_fmu\.generate"):
        build(tmp_path / "x.fmu")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('name = "mass_kg"', 'name = "inertia_kg_m2"', "'inertia_kg_m2' is defined twice"),
        ('unit = "kg"', 'unit = "lb"', r"mass_kg: unit 'lb' is not in \[units\]"),
        (
            'unit = "rad/s"\ndisplay_unit = "deg/s"\ndescription = "Yaw rate"',
            'unit = "rad/s"\ndisplay_unit = "deg"\ndescription = "Yaw rate"',
            r"twist\.yaw_rate_rad_s: display_unit 'deg' is not in \[display_units\] of its unit",
        ),
        ("start = 20.0\n", "", "mass_kg: an input or a parameter needs a start value"),
        (
            'name = "mass_kg"\ncausality = "parameter"',
            'name = "mass_kg"\ncausality = "local"',
            "causality 'local'",
        ),
        (
            '"wheel.*.torque_n_m", "drive.enabled"]\ndescription = "Motor current',
            '"motor.*.torque_n_m", "drive.enabled"]\ndescription = "Motor current',
            r"wheel\.fl\.current_a: depends_on names the unknown 'motor\.fl\.torque_n_m'",
        ),
    ],
)
def test_a_wrong_definition_is_refused(tmp_path: Path, old: str, new: str, words: str) -> None:
    text = (generate.HERE / "variables.toml").read_text(encoding="utf-8")
    assert text.count(old) == 1
    path = tmp_path / "variables.toml"
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(variables.DefinitionError, match=words):
        variables.read(path)


@pytest.mark.parametrize(
    ("old", "new", "name"),
    [('"pose.x_m"', '"pose.z_m"', "pose.z_m"), ('change."gyro.x_rad_s"', 'change."gyro_x"', "gyro_x")],
)
def test_mujocos_variables_are_those_of_the_rigid_plant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, old: str, new: str, name: str
) -> None:
    text = definition.PARTS[1].read_text(encoding="utf-8")
    (tmp_path / "own.toml").write_text(text.replace(old, new), encoding="utf-8")
    monkeypatch.setattr(definition, "PARTS", (definition.PARTS[0], tmp_path / "own.toml"))
    with pytest.raises(
        variables.DefinitionError, match=rf"^mujoco/variables\.toml: '{name}' is not in \.\./variables\.toml$"
    ):
        definition.read()


@pytest.mark.parametrize(
    ("machine", "system", "wide", "name"),
    [
        ("x86_64", "linux", True, "x86_64-linux"),
        ("AMD64", "win32", True, "x86_64-windows"),
        ("AMD64", "win32", False, "x86-windows"),
        ("i686", "linux", False, "x86-linux"),
        ("arm64", "darwin", True, "aarch64-darwin"),
        ("aarch64", "linux", True, "aarch64-linux"),
    ],
)
def test_a_machine_has_the_standards_name(
    monkeypatch: pytest.MonkeyPatch, machine: str, system: str, wide: bool, name: str
) -> None:
    monkeypatch.setattr("platform.machine", lambda: machine)
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr(sys, "maxsize", 2**63 - 1 if wide else 2**31 - 1)
    assert platforms.this_platform() == name


@share_of_examples(0.3)
@given(st.lists(st.binary(min_size=12, max_size=40_000), min_size=1, max_size=3))
def test_a_universal_binary_gives_back_what_went_in(libraries: list[bytes]) -> None:
    made = platforms.universal(libraries)
    assert int.from_bytes(made[4:8], "big") == len(libraries)
    for place, content in enumerate(libraries):
        entry = made[8 + 20 * place :][:20]
        processor, subtype, start, size, alignment = (int.from_bytes(entry[k : k + 4], "big") for k in range(0, 20, 4))
        assert made[start : start + size] == content
        assert start % (1 << alignment) == 0
        assert (processor, subtype) == tuple(int.from_bytes(content[k : k + 4], "little") for k in (4, 8))


def test_an_arm_machines_own_fmi_2_fmu_has_the_name_that_importers_look_for() -> None:
    assert platforms.members(2, "m", {"aarch64-linux": b"arm"}) == {
        "binaries/aarch64-linux/m.so": b"arm",
        "binaries/linux64/m.so": b"arm",
    }
    both = platforms.members(2, "m", {"aarch64-linux": b"arm", "x86_64-linux": b"x86"})
    assert both == {"binaries/aarch64-linux/m.so": b"arm", "binaries/linux64/m.so": b"x86"}
    assert list(platforms.members(3, "m", {"aarch64-darwin": b""})) == ["binaries/aarch64-darwin/m.dylib"]
    assert set(platforms.members(2, "m", {"x86-linux": b"", "x86-windows": b"", "aarch32-linux": b""})) == {
        *("binaries/linux32/m.so", "binaries/win32/m.dll", "binaries/aarch32-linux/m.so")
    }
    assert platforms.members(2, "m", {"x86_64-windows": b"x86"}) == {"binaries/win64/m.dll": b"x86"}


def test_for_macos_fmi_2_has_both_processors_in_one_binary_and_fmi_3_each_alone() -> None:
    x86, arm = (b"lib-" + bytes([kind, 0, 0, 1, 3, 0, 0, 0]) + b"code" for kind in (7, 12))
    libraries = {"aarch64-darwin": arm, "x86_64-darwin": x86}
    both = platforms.members(2, "m", libraries)
    assert set(both) == {"binaries/darwin64/m.dylib", "binaries/aarch64-darwin/m.dylib"}
    assert both["binaries/aarch64-darwin/m.dylib"] == arm
    assert both["binaries/darwin64/m.dylib"] == platforms.universal([x86, arm])
    assert both["binaries/darwin64/m.dylib"][:8].hex() == "cafebabe00000002"
    assert platforms.members(3, "m", libraries) == {f"binaries/{name}/m.dylib": libraries[name] for name in libraries}


def test_generate_writes_what_is_stale_and_with_check_only_names_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = {path.relative_to(generate.HERE): text for path, text in generate.render(variables.read()).items()}
    for path, text in files.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text, encoding="utf-8")
    monkeypatch.setattr(generate, "HERE", tmp_path)
    monkeypatch.setattr(generate, "GENERATED", tmp_path / "generated")
    (tmp_path / "generated" / "mecanum_variables.h").write_text("stale", encoding="utf-8")
    (tmp_path / "generated" / "fmi3").rename(tmp_path / "aside")
    monkeypatch.setattr(sys, "argv", ["generate", "--check"])
    with pytest.raises(
        SystemExit, match=r"^generated.fmi3.modelDescription\.xml is stale; run python -m plant_fmu\.gen"
    ):
        generate.main()
    assert not (tmp_path / "generated" / "fmi3").exists()
    monkeypatch.setattr(sys, "argv", ["generate"])
    generate.main()
    printed = [Path(line).name for line in capsys.readouterr().out.splitlines()]
    assert printed == ["modelDescription.xml", "terminalsAndIcons.xml", "mecanum_variables.h"]
    assert {path: (tmp_path / path).read_text(encoding="utf-8") for path in files} == files


def test_the_page_has_a_row_for_each_variable_in_words_of_its_definition() -> None:
    page = tables.page(variables.read()).splitlines()
    rows = [line for line in page if line.startswith("| `")]
    written = tomllib.loads((generate.HERE / "variables.toml").read_text(encoding="utf-8"))["variable"]
    assert [row.split("`")[1] for row in rows] == [entry["name"] for entry in written] + ["time"]
    assert page[4:6] == ["| variable | causality | unit | start | range | meaning |", "|---|---|---|---|---|---|"]
    for row in (
        "| `mass_kg` | tunable parameter | kg | 20 | 0.01 to 10000 | Mass of the robot with its wheels, m |",
        "| `wheel.*.angle_rad` | output | rad |  |  | Angle of the wheel since the start; not wrapped |",
        "| `rollers` | parameter |  | x | x (1), o (2) | How the four wheels are mounted, as seen from above |",
        "| `wheel_radius_m` | parameter | m | 0.075 | 0.001 to 10 | Wheel radius, r |",
    ):
        assert row in rows


def test_an_item_that_is_not_the_first_is_a_start_by_its_name() -> None:
    found = variables.read()
    changed = [dataclasses.replace(one, start=3) if one.name == "drive" else one for one in found.variables]
    page = tables.page(dataclasses.replace(found, variables=tuple(changed)))
    assert (
        "| `drive` | parameter |  | voltage | torque (1), current (2), voltage (3) | What drives the wheels |" in page
    )


def test_a_page_without_its_marks_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(tables, "HERE", tmp_path)
    (tmp_path / "documentation").mkdir()
    for mark in ("<!-- variables: begin -->", "<!-- variables: end -->", ""):
        (tmp_path / tables.DOCUMENT).write_text(f"<p>{mark}</p>", encoding="utf-8")
        with pytest.raises(variables.DefinitionError, match=r"documentation/index\.html: the marks .* are missing"):
            tables.document(variables.read())
