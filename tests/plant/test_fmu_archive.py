"""Files that are no FMU for us are refused, each with one sentence that names the file; nothing of them is run."""

import contextlib
import os
import stat
import struct
import subprocess
import sys
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import plant_fmu
from hil.addons.fmu_check.check import check
from hil.addons.fmu_check.info import info
from hil.core.errors import BadInputError
from hil.plant import archive
from plant_fmu import platforms
from tests.support.broken_fmu import Change, pack
from tests.support.examples import share_of_examples
from tests.support.plant_testbed import FMU

DIRECTORY_ENTRY, LOCAL_ENTRY = b"PK\x01\x02", b"PK\x03\x04"


def replaced(old: str, new: str) -> Change:
    """Change the description."""

    def change(name: str, data: bytes) -> bytes:
        assert old.encode() in data or name != "modelDescription.xml"
        return data.replace(old.encode(), new.encode()) if name == "modelDescription.xml" else data

    return change


def without(part: str) -> Change:
    return lambda name, data: None if part in name else data


def link(path: Path) -> None:
    entry = zipfile.ZipInfo("resources/link")
    entry.create_system, entry.external_attr = 3, (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(path, "a") as packed:
        packed.writestr(entry, "/etc/passwd")


def written(path: Path, offset_in_directory: int, offset_in_entry: int, value: bytes) -> None:
    """Write into the headers of the archive's last entry: in the directory at the end, and before its bytes."""
    data = bytearray(path.read_bytes())
    for place, offset in (
        (data.rindex(DIRECTORY_ENTRY), offset_in_directory),
        (data.rindex(LOCAL_ENTRY), offset_in_entry),
    ):
        data[place + offset : place + offset + len(value)] = value
    path.write_bytes(data)


def many(path: Path) -> None:
    with zipfile.ZipFile(path, "a") as packed:
        for number in range(20_001):
            packed.writestr(f"resources/{number}", b"")


Make = Callable[[Path], object]


def added(*names: str) -> Make:
    return lambda path: pack(path, 2, added=[(name, b"") for name in names])


def inside(*names: str) -> Make:
    """Make an archive that has these alone."""

    def make(path: Path) -> None:
        with zipfile.ZipFile(path, "w") as packed:
            for name in names:
                packed.writestr(name, b"")

    return make


def changed(change: Change, fmi: int = 2) -> Make:
    return lambda path: pack(path, fmi, change)


def altered(alter: Callable[[Path], object], name: str = "resources/last") -> Make:
    def make(path: Path) -> None:
        pack(path, 2, added=[(name, b"bytes")])
        alter(path)

    return make


DTD = '<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;"><!ENTITY c "&b;&b;&b;&b;">]>\n<fmiModelDescription'
EXTERNAL = '<!DOCTYPE x SYSTEM "file:///etc/passwd">\n<fmiModelDescription'
BUILD = ("sources/buildDescription.xml", b'<!DOCTYPE x [<!ENTITY a "ha">]>\n<fmiBuildDescription/>')

NOT_AN_FMU: list[tuple[str, Make, str]] = [
    ("missing", lambda path: None, "does not exist; give the path"),
    ("a text", lambda path: path.write_text("a text"), "not a zip archive"),
    ("no description", changed(without("modelDescription")), "it has no modelDescription.xml"),
    ("broken XML", changed(replaced("</fmiModelDescription>", "")), "cannot be read (no element found"),
    ("unknown encoding", changed(replaced("UTF-8", "none")), "cannot be read (unknown encoding"),
    ("another root", changed(replaced("fmiModelDescription", "svg")), "has the root 'svg'"),
    ("growing entities", changed(replaced("<fmiModelDescription", DTD)), "has a document type definition"),
    ("external entities", changed(replaced("<fmiModelDescription", EXTERNAL)), "has a document type definition"),
    ("entities elsewhere", lambda path: pack(path, 3, added=[BUILD]), "sources/buildDescription.xml has a document"),
    ("FMI 1", changed(replaced('fmiVersion="2.0"', 'fmiVersion="1.0"')), "FMI version 1.0; expected 2.0 or 3.0"),
    ("a draft", changed(replaced('"3.0"', '"3.0-beta.1"'), 3), "FMI version 3.0-beta.1; expected 2.0 or 3.0"),
    ("no version", changed(replaced('fmiVersion="2.0"', "")), "FMI version missing; expected"),
    ("a parent", added("../outside"), "its entry '../outside' leads out of the archive; it is not opened"),
    ("a parent inside", added("a/../../outside"), "leads out of the archive"),
    ("an absolute path", added("/etc/outside"), "its entry '/etc/outside' leads out"),
    ("a backslash", added("a\\..\\outside"), "leads out of the archive"),
    ("a drive", added("C:/outside"), "leads out of the archive"),
    ("no name", added("."), "its entry '.' has no name; it is not opened"),
    ("a terminal's escape", added("resources/\x1b[2J"), "has a character in its name that cannot be printed"),
    ("twice, differently", lambda path: pack(path, 2, added=[("a", b"1"), ("a", b"2")]), "'a' is there twice, with"),
    ("FMUs", inside("a.fmu", "b.fmu"), "it has no modelDescription.xml, so it is no FMU"),
    ("in a folder", inside("robot/modelDescription.xml"), "it has 'robot/modelDescription.xml'; expected 'modelDes"),
    ("below a dot", inside("./modelDescription.xml"), "it has './modelDescription.xml'; expected 'modelDescription"),
    ("a pointer", lambda path: path.write_text("version https://git-lfs.github.com/spec/v1"), "run git lfs pull"),
    ("cut", lambda path: path.write_bytes(pack(path, 2).read_bytes()[:-9]), "a damaged zip archive; copy it again"),
    ("a link", altered(link), "its entry 'resources/link' is a symbolic link"),
    ("encrypted", altered(lambda p: written(p, 8, 6, b"\1\0")), "its entry 'resources/last' is encrypted"),
    ("encrypted strongly", altered(lambda p: written(p, 8, 6, b"\x40\0")), "its entry 'resources/last' is encrypted"),
    ("bzip2", altered(lambda p: written(p, 10, 8, b"\x0c\0")), "is packed by method 12; expected 0 (stored) or 8"),
    ("huge", altered(lambda p: written(p, 24, 22, struct.pack("<I", 0xF0000000))), "it unpacks to 40265"),
    ("many entries", altered(many), "entries; expected at most 20000"),
    (
        "a huge description",
        altered(lambda p: written(p, 24, 22, struct.pack("<I", 0x0F000000)), "sources/buildDescription.xml"),
        "claims 251658240 bytes; that is no description",
    ),
]
# An FMU that a check fails, and that nobody runs.
BROKEN: list[tuple[str, Make, str]] = [
    ("no identifier", changed(replaced('modelIdentifier="lag"', "")), "its CoSimulation has no modelIdentifier"),
]
# One that may be in order, and has nothing to run here.
NOT_FOR_US: list[tuple[str, Make, str]] = [
    (
        "scheduled",
        changed(replaced("CoSimulation", "ScheduledExecution"), 3),
        "interface is ScheduledExecution; expected",
    ),
    ("no interface", changed(replaced("<CoSimulation", "<Something")), "interface is none at all; expected"),
    ("a way out", changed(replaced('modelIdentifier="lag"', 'modelIdentifier="../../lag"')), "/../../lag"),
    (
        "another identifier",
        changed(replaced('modelIdentifier="lag"', 'modelIdentifier="no"')),
        "/no.",
    ),
    ("no binaries", changed(without("binaries")), "for this platform; it has no binaries"),
    (
        "another platform",
        lambda path: pack(path, 3, without("binaries"), [("binaries/riscv64-linux/lag.so", b"")]),
        "for this platform; it has binaries for riscv64-linux",
    ),
]


def ids(cases: list[tuple[str, Make, str]]) -> list[str]:
    return [name for name, _, _ in cases]


def extract(fmu: Path) -> None:
    with archive.extract(fmu):
        pass


def refusal(open_it: Callable[[Path], object], fmu: Path) -> str:
    with pytest.raises(BadInputError) as caught:
        open_it(fmu)
    text = str(caught.value)
    assert str(fmu) in text
    assert text.isprintable(), repr(text)
    return text


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize(("_name", "make", "words"), NOT_AN_FMU, ids=ids(NOT_AN_FMU))
def test_no_tool_opens_what_is_no_fmu(_name: str, make: Make, words: str, tmp_path: Path) -> None:
    fmu = tmp_path / "foreign.fmu"
    make(fmu)
    for open_it in (archive.library_of, info, check):
        assert words in refusal(open_it, fmu)


@pytest.mark.parametrize(("_name", "make", "words"), NOT_FOR_US, ids=ids(NOT_FOR_US))
def test_an_fmu_without_a_library_for_us_is_refused_and_can_be_looked_at(
    _name: str, make: Make, words: str, tmp_path: Path
) -> None:
    fmu = tmp_path / "foreign.fmu"
    make(fmu)
    for open_it in (archive.library_of, check):
        assert words in refusal(open_it, fmu)
    assert info(fmu).model_name == "lag"


@pytest.mark.parametrize(("_name", "make", "words"), BROKEN, ids=ids(BROKEN))
def test_an_fmu_that_contradicts_itself_is_refused_and_fails_a_check(
    _name: str, make: Make, words: str, tmp_path: Path
) -> None:
    fmu = tmp_path / "foreign.fmu"
    make(fmu)
    assert words in refusal(archive.library_of, fmu)
    assert any(words in violation for violation in check(fmu).violations)


def test_a_folder_is_called_a_folder(tmp_path: Path) -> None:
    folder = tmp_path / "unpacked.fmu"
    folder.mkdir()
    for open_it in (lambda fmu: archive.locate(str(fmu), tmp_path), archive.library_of, info, check):
        assert "is a folder; expected an .fmu file" in refusal(open_it, folder)


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_fmu_for_model_exchange_alone_is_refused(fmi: int, tmp_path: Path) -> None:
    fmu = pack(tmp_path / "a.fmu", fmi, replaced("CoSimulation", "ModelExchange"))
    assert "its interface is ModelExchange; expected co-simulation" in refusal(check, fmu)


@pytest.mark.parametrize("fmi", [2, 3])
def test_the_library_of_an_fmu(fmi: int, tmp_path: Path) -> None:
    library = archive.library_of(pack(tmp_path / "a.fmu", fmi))
    assert library[1:] == (f"{fmi}.0", "lag")
    both = pack(tmp_path / "c.fmu", fmi, replaced("<CoSimulation", '<ModelExchange modelIdentifier="x"/><CoSimulation'))
    assert archive.library_of(both)[2:] == ("lag",)


def test_a_library_for_the_very_machine_is_preferred_in_fmi_2(tmp_path: Path) -> None:
    best, usual = (f"binaries/{folder}/lag{archive.LIBRARY_SUFFIX}" for folder in archive.binary_folders("2.0"))
    assert archive.library_of(pack(tmp_path / "a.fmu", 2)).member == usual
    assert archive.library_of(pack(tmp_path / "b.fmu", 2, added=[(best, b"")])).member == best


@pytest.mark.parametrize(
    ("machine", "wide", "tuple_name", "word_size_name"),
    [("i686", False, "x86-linux", "linux32"), ("aarch64", True, "aarch64-linux", "linux64")],
)
def test_what_is_built_for_a_machine_is_found_on_it(
    monkeypatch: pytest.MonkeyPatch, machine: str, wide: bool, tuple_name: str, word_size_name: str
) -> None:
    monkeypatch.setattr("platform.machine", lambda: machine)
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setattr("sys.maxsize", 2**63 - 1 if wide else 2**31 - 1)
    assert archive.binary_folders("3.0") == (tuple_name,)
    assert archive.binary_folders("2.0") == (tuple_name, word_size_name)
    for fmi in (2, 3):
        built = platforms.members(fmi, "m", {platforms.this_platform(): b""})
        assert {name.split("/")[1] for name in built} & set(archive.binary_folders(f"{fmi}.0"))


def test_a_patch_release_of_fmi_3_is_fmi_3(tmp_path: Path) -> None:
    fmu = pack(tmp_path / "a.fmu", 3, replaced('fmiVersion="3.0"', 'fmiVersion="3.0.2"'))
    assert archive.library_of(fmu).fmi_version == "3.0"


def test_nothing_is_written_outside_or_left_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(scratch))
    for name in ("../outside", "resources/last"):
        fmu = pack(tmp_path / "a.fmu", 2, added=[(name, b"bytes that are damaged")])
        fmu.write_bytes(fmu.read_bytes().replace(b"are damaged", b"ARE DAMAGED"))
        refusal(extract, fmu)
    assert list(scratch.iterdir()) == []
    assert not (tmp_path / "outside").exists()


# Names that other systems cannot hold.
ODD: list[tuple[tuple[str, ...], str]] = [
    (("resources/log 12:30.csv",), "cannot be unpacked on Windows because of 'log 12:30.csv'"),
    (("resources/aux.c",), "cannot be unpacked on Windows because of 'aux.c'"),
    (("resources./a",), "cannot be unpacked on Windows because of 'resources.'"),
    (("resources/a", "Resources/A"), "would be one file"),
    (("resources/\u00e9", "resources/e\u0301"), "would be one file"),
    (("resources/a", "resources/a"), ""),
    (("resources/\u4e2d\u3000\u6587.csv",), ""),
]


@pytest.mark.skipif(sys.platform != "linux", reason="the names of Linux")
@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize(("names", "words"), ODD)
def test_a_name_that_another_system_cannot_hold_is_refused_there(
    names: tuple[str, ...], words: str, tmp_path: Path
) -> None:
    fmu = tmp_path / "odd.fmu"
    added(*names)(fmu)
    with archive.extract(fmu) as folder:
        assert {path.relative_to(folder).as_posix() for path in folder.rglob("*")} >= set(names)
    for system in ("win32", "darwin"):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "platform", system)
            patch.setattr(archive, "_FOLDS_NAMES", True)
            is_refused = "one file" in words or (system == "win32" and bool(words))
            with pytest.raises(BadInputError, match=words) if is_refused else contextlib.nullcontext():
                archive.platforms(fmu)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no executable bits")
def test_a_program_in_resources_can_be_run(tmp_path: Path) -> None:
    fmu = pack(tmp_path / "a.fmu", 2)
    entry = zipfile.ZipInfo("resources/tool")
    entry.create_system, entry.external_attr = 3, (stat.S_IFREG | 0o755) << 16
    with zipfile.ZipFile(fmu, "a") as packed:
        packed.writestr(entry, "#!/bin/sh\necho it runs\n")
    with archive.extract(fmu) as folder:
        assert subprocess.run([folder / "resources/tool"], capture_output=True, check=True).stdout == b"it runs\n"
        assert not os.access(folder / "modelDescription.xml", os.X_OK)


def test_a_file_where_a_folder_has_to_be_is_refused(tmp_path: Path) -> None:
    fmu = pack(tmp_path / "a.fmu", 2, added=[("resources", b""), ("resources/a", b"")])
    assert "its entry 'resources/a' cannot be written" in refusal(extract, fmu)


@pytest.mark.parametrize("name", ["modelDescription.xml", "resources/last"])
def test_an_entry_that_is_larger_than_it_says_is_not_unpacked_into_memory(name: str, tmp_path: Path) -> None:
    size = 64 * 1024 * 1024
    fmu = tmp_path / "bomb.fmu"
    pack(fmu, 2, without(name))
    with zipfile.ZipFile(fmu, "a", zipfile.ZIP_DEFLATED) as packed:
        packed.writestr(name, bytes(size))
    written(fmu, 24, 22, struct.pack("<I", 1000))
    tracemalloc.start()
    try:
        assert "cannot be unpacked (Bad CRC-32" in refusal(extract, fmu)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < size / 16


def test_extraction_gives_the_bytes_of_all_entries_or_of_those_asked_for(tmp_path: Path) -> None:
    folders = [("resources/deep/", b""), ("resources/empty/folder/", b"")]
    fmu = pack(tmp_path / "a.fmu", 3, added=[("resources/deep/down/file", os.urandom(200_000)), *folders])
    with zipfile.ZipFile(fmu) as packed:
        files = {name: packed.read(name) for name in packed.namelist() if not name.endswith("/")}
    with archive.extract(fmu) as folder:
        unpacked = {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
        assert (folder / "resources/empty/folder").is_dir()
    assert unpacked == files
    assert not folder.exists()
    with archive.extract(fmu, only=archive.DESCRIPTIONS.__contains__) as folder:
        assert [path.name for path in folder.rglob("*")] == ["modelDescription.xml"]


def mutated(data: bytes, edits: list[tuple[int, bytes]], length: int) -> bytes:
    out = bytearray(data)
    for place, value in edits:
        place %= len(out)
        out[place : place + len(value)] = value
    return bytes(out[: length % (len(out) + 1) or len(out)])


EDITS = st.lists(st.tuples(st.integers(0, 2**20), st.binary(min_size=1, max_size=8)), max_size=6)


@share_of_examples(4.0)
@given(st.sampled_from([2, 3]), EDITS, st.one_of(st.just(0), st.integers(0, 2**16)))
def test_no_bytes_of_an_archive_raise_anything_but_bad_input(
    tmp_path_factory: pytest.TempPathFactory, fmi: int, edits: list[tuple[int, bytes]], length: int
) -> None:
    fmu = tmp_path_factory.getbasetemp() / "fuzzed.fmu"
    fmu.write_bytes(mutated(pack(fmu, fmi, added=[BUILD_OK]).read_bytes(), edits, length))
    opens_or_refuses(fmu)


@share_of_examples(4.0)
@given(st.sampled_from([2, 3]), EDITS, st.one_of(st.just(0), st.integers(0, 2**16)))
def test_no_description_raises_anything_but_bad_input(
    tmp_path_factory: pytest.TempPathFactory, fmi: int, edits: list[tuple[int, bytes]], length: int
) -> None:
    fmu = tmp_path_factory.getbasetemp() / "fuzzed.fmu"
    pack(fmu, fmi, lambda name, data: mutated(data, edits, length) if name.endswith(".xml") else data)
    opens_or_refuses(fmu)


BUILD_OK = ("sources/buildDescription.xml", b'<fmiBuildDescription fmiVersion="3.0"/>')


def opens_or_refuses(fmu: Path) -> None:
    for open_it in (archive.library_of, info, extract):
        with contextlib.suppress(BadInputError):
            open_it(fmu)


def test_a_copy_of_the_shipped_fmu_is_the_shipped_fmu(tmp_path: Path) -> None:
    copy = tmp_path / "copy.fmu"
    copy.write_bytes(FMU.read_bytes())
    assert archive.is_shipped(copy)
    copy.write_bytes(FMU.read_bytes() + b"\0")
    assert not archive.is_shipped(copy)


def test_locate(tmp_path: Path) -> None:
    assert archive.locate("mecanum", tmp_path) == FMU
    (tmp_path / "mine.fmu").write_bytes(b"")
    assert archive.locate("mine.fmu", tmp_path) == tmp_path / "mine.fmu"
    with pytest.raises(BadInputError, match=r"FMU 'mecanun' does not exist at .*; did you mean 'mecanum'\?"):
        archive.locate("mecanun", tmp_path)


def test_a_shipped_fmu_that_was_not_built_is_named_with_the_command_that_builds_it() -> None:
    for name, path in plant_fmu.SHIPPED.items():
        if not path.exists():
            with pytest.raises(BadInputError, match=r"is not built; run: hil fmu build( --mujoco)?$"):
                archive.locate(name, Path())
