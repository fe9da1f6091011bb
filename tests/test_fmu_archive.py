"""Files that are no FMU for us are refused, each with one sentence that names the file."""

import stat
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from hil.errors import BadInputError
from hil.plant import archive
from hil.plant.fmu import FmuPlant
from hil.plant.tools import check, info
from tests.plant_testbed import FMU

Change = Callable[[str, bytes], bytes | None]


def repack(target: Path, change: Change = lambda _, data: data, **added: bytes) -> Path:
    """Copy the shipped FMU with its members changed, left out (None) or added."""
    with zipfile.ZipFile(FMU) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            data = change(name, old.read(name))
            if data is not None:
                new.writestr(name, data)
        for name, data in added.items():
            new.writestr(name, data)
    return target


def in_description(old: str, new: str) -> Change:
    def change(name: str, data: bytes) -> bytes:
        return data.replace(old.encode(), new.encode()) if name == "modelDescription.xml" else data

    return change


def without(start: str) -> Change:
    return lambda name, data: None if name.startswith(start) else data


def missing(path: Path) -> Path:
    return path


def not_a_zip(path: Path) -> Path:
    path.write_text("a text")
    return path


def symbolic_link(path: Path) -> Path:
    with zipfile.ZipFile(repack(path), "a") as archive:
        entry = zipfile.ZipInfo("resources/link")
        entry.create_system, entry.external_attr = 3, (stat.S_IFLNK | 0o777) << 16
        archive.writestr(entry, "/etc/passwd")
    return path


def absurd_size(path: Path) -> Path:
    """A member that says it unpacks to more than we take; the number is in the archive's directory."""
    data = bytearray(repack(path).read_bytes())
    entry = data.rindex(b"PK\x01\x02")
    data[entry + 24 : entry + 28] = (0xF0000000).to_bytes(4, "little")
    path.write_bytes(data)
    return path


CASES: list[tuple[Callable[[Path], Path], str]] = [
    (missing, "does not exist; give the path"),
    (not_a_zip, "not a zip archive"),
    (lambda path: repack(path, without("modelDescription")), "it has no modelDescription.xml"),
    (
        lambda path: repack(path, in_description("</fmiModelDescription>", "")),
        "cannot be read (no element found",
    ),
    (
        lambda path: repack(path, in_description('encoding="UTF-8"', 'encoding="none"')),
        "its modelDescription.xml cannot be read (unknown encoding",
    ),
    (lambda path: repack(path, **{"../outside": b""}), "its entry '../outside' leads out of the archive"),
    (lambda path: repack(path, **{"/etc/outside": b""}), "its entry '/etc/outside' leads out"),
    (lambda path: repack(path, **{"a\\..\\outside": b""}), "leads out of the archive"),
    (symbolic_link, "its entry 'resources/link' is a symbolic link"),
    (absurd_size, "it unpacks to "),
    (
        lambda path: repack(path, in_description('fmiVersion="2.0"', 'fmiVersion="1.0"')),
        "FMI version 1.0; expected",
    ),
    (
        lambda path: repack(path, in_description("CoSimulation", "ScheduledExecution")),
        "it is neither for co-simulation",
    ),
    (lambda path: repack(path, without("binaries")), "for this platform; it has no binaries"),
    (
        lambda path: repack(path, without("binaries"), **{"binaries/riscv64/mecanum.so": b""}),
        "for this platform; it has binaries for riscv64",
    ),
]


@pytest.mark.parametrize(("make", "words"), CASES, ids=[words[:40] for _, words in CASES])
def test_a_plant_is_made_of_nothing_else(make: Callable[[Path], Path], words: str, tmp_path: Path) -> None:
    fmu = make(tmp_path / "foreign.fmu")
    with pytest.raises(BadInputError) as caught:
        FmuPlant(fmu, {})
    text = str(caught.value)
    assert words in text
    assert str(fmu) in text
    assert "\n" not in text


@pytest.mark.parametrize(("make", "words"), CASES[:10], ids=[words[:40] for _, words in CASES[:10]])
@pytest.mark.parametrize("tool", [info, check])
def test_the_tools_refuse_what_is_no_fmu(
    tool: Callable[[Path], object], make: Callable[[Path], Path], words: str, tmp_path: Path
) -> None:
    with pytest.raises(BadInputError) as caught:
        tool(make(tmp_path / "foreign.fmu"))
    assert words in str(caught.value)


def test_nothing_is_written_outside(tmp_path: Path) -> None:
    with pytest.raises(BadInputError):
        archive.extract(repack(tmp_path / "a.fmu", **{"../outside": b""}))
    assert not (tmp_path / "outside").exists()


def test_a_damaged_member_is_refused_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = bytearray(FMU.read_bytes())
    data[data.index(b"\x7fELF" if b"\x7fELF" in data else b"mecanum.") + 100] ^= 1
    fmu, scratch = tmp_path / "damaged.fmu", tmp_path / "scratch"
    fmu.write_bytes(data)
    scratch.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(scratch))
    with pytest.raises(BadInputError, match="cannot be unpacked"):
        archive.extract(fmu)
    assert list(scratch.iterdir()) == []


def test_a_copy_of_the_shipped_fmu_is_the_shipped_fmu(tmp_path: Path) -> None:
    copy = tmp_path / "copy.fmu"
    copy.write_bytes(FMU.read_bytes())
    assert archive.is_shipped(copy)
    with FmuPlant(copy, {}) as plant:
        assert plant.truth().time_ns == 0


def test_locate(tmp_path: Path) -> None:
    assert archive.locate("mecanum", tmp_path) == FMU
    (tmp_path / "mine.fmu").write_bytes(b"")
    assert archive.locate("mine.fmu", tmp_path) == tmp_path / "mine.fmu"
    with pytest.raises(BadInputError, match=r"FMU 'mecanun' does not exist at .*; did you mean 'mecanum'\?"):
        archive.locate("mecanun", tmp_path)


def test_info() -> None:
    about = info(FMU)
    assert about.shipped
    assert (about.fmi_version, about.co_simulation, about.model_exchange) == ("2.0", "mecanum", None)
    assert "canGetAndSetFMUstate" in about.capabilities
    by_name = {variable.name: variable for variable in about.variables}
    mass = by_name["mass_kg"]
    assert (mass.causality, mass.unit, mass.start, mass.type) == ("parameter", "kg", "20.0", "Real")
    assert by_name["pose.x_m"].start is None
