"""The libraries used match the sources next to them, by hash; others are built again, or refused in a sentence."""

import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

import hil
from firmware_protocol import built as native
from firmware_protocol import extension, host
from firmware_protocol.built import WHEEL_HOST, BuildError, Built, digest_in_library
from firmware_protocol.declarations import HEADERS, TABLE, are_written, declared, write_declarations
from hil.cli.main import app
from hil.core.errors import BadInputError
from hil.plant import archive, shim
from hil.plant.built import COSIM, FMUS, MUJOCO, PLANT_PORT
from hil.record.reader import read
from tests.support.processes import ROOT

EDITED = """
import ctypes
from firmware_protocol.built import BuildError
from hil.plant.built import COSIM
try:
    COSIM.make_current()
except BuildError as error:
    print(error)
else:
    print(hasattr(ctypes.CDLL(str(COSIM.path)), "edited"))
"""
PLANTS = {path: built for path, built in FMUS.items() if path != MUJOCO}
ALL = [WHEEL_HOST, COSIM, *PLANTS.values()]


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout of the FMU's shim alone, with its library."""
    port = PLANT_PORT.relative_to(ROOT)
    of_the_wire = (Path("firmware_protocol", f"{name}.py") for name in ("__init__", "built", "declarations"))
    for path in (Path("hil/__init__.py"), Path("pyproject.toml"), port, *of_the_wire):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / path, tmp_path / path)
    for package in ("tools/build", "plant_fmu", "hil/plant"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def started(folder: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", EDITED],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(folder)},
        cwd=folder,
    )


def said(process: subprocess.Popen[str]) -> tuple[str, str]:
    """Return what a process has printed on stdout and stderr by its end."""
    output, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors
    return output.strip(), errors.strip()


def test_edited_sources_are_what_runs(checkout: Path) -> None:
    source = checkout / "hil/plant/derive.c"
    os.utime(source)  # newer than the library, and the same: git and copies do that
    assert said(started(checkout)) == ("False", "")

    with source.open("a", encoding="utf-8") as file:
        file.write("int edited(void);\nint edited(void) { return 1; }\n")
    os.utime(source, (0, 0))  # older than the library
    told = [said(process) for process in (started(checkout), started(checkout))]  # both build it at the same time
    assert [output for output, _ in told] == ["True", "True"]
    for _, errors in told:
        what = f"{COSIM.path.name} was not built from the sources beside it"
        assert errors in ("", f"{what}: running python -m tools.build.cosim")
    assert list((checkout / "hil/plant").glob(".*")) == [], "nothing half built is left"

    source.write_text("this is no C\n", encoding="utf-8")
    output, _ = said(started(checkout))
    assert "was not built from the sources beside it, and python -m tools.build.cosim could not build it:" in output
    assert "derive.c" in output
    (checkout / "pyproject.toml").unlink()  # as in site-packages
    output, errors = said(started(checkout))
    assert "and it can only be built in a checkout; install the package again" in output
    assert errors == ""


@pytest.mark.parametrize("built", ALL, ids=lambda built: built.path.name)
def test_what_is_there_is_current_until_a_source_changes(built: Built, tmp_path) -> None:
    assert built.is_current()
    assert built.read(built.path) == built.digest()
    copies = []
    for source in built.sources:
        copies.append(tmp_path / source.relative_to(ROOT))
        copies[-1].parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(source, copies[-1])
    copied = built._replace(sources=tuple(copies), root=tmp_path)
    assert copied.is_current()
    for copy in (copies[0], copies[-1]):
        content = copy.read_bytes()
        copy.write_bytes(content + b"\n")
        assert not copied.is_current()
        copy.write_bytes(content)
        assert copied.is_current()
    copies[0].unlink()
    assert not copied.is_current()
    assert not copied._replace(flags=(*built.flags, "-ffast-math")).is_current()
    assert copied._replace(sources=(tmp_path / "none.c",)).is_current(), "without sources there is nothing to compare"


@pytest.fixture
def installed_with_other_sources(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Have every native part be one that was not built from the sources beside it, outside a checkout."""
    hil.run("circle_speed", set={"loop.duration_s": 0.1, "expect": []})  # functions that imports make stay
    monkeypatch.setattr(native, "is_checkout", lambda _: False)
    others = [built._replace(flags=("another",)) for built in ALL]
    monkeypatch.setattr(extension, "WHEEL_HOST", others[0])
    monkeypatch.setattr(shim, "COSIM", others[1])
    monkeypatch.setattr(archive, "FMUS", dict(zip(PLANTS, others[2:], strict=True)))
    caches = (extension.loaded, host.parameters, shim.loaded, archive._make_current)
    for cache in caches:
        cache.cache_clear()
    yield
    for cache in caches:
        cache.cache_clear()


@pytest.mark.usefixtures("installed_with_other_sources")
def test_what_cannot_be_built_anew_is_refused_in_a_sentence() -> None:
    done = CliRunner().invoke(app, ["run", "circle_speed", "--record", "none"])
    assert isinstance(done.exception, BadInputError)
    for load in (shim.load, lambda: archive.locate("mecanum", Path()), lambda: archive.locate("mecanum_fmi3", Path())):
        with pytest.raises(BadInputError, match="it can only be built in a checkout"):
            load()
    with pytest.raises(BuildError, match=r"_wheel\.\S+ was not built from the sources beside it"):
        extension.library()


def test_a_script_that_builds_nothing_and_says_nothing_is_told_by_its_exit_code(tmp_path: Path) -> None:
    (tmp_path / "quiet.py").write_text("raise SystemExit(3)", encoding="utf-8")
    for name in ("pyproject.toml", "a.c"):
        (tmp_path / name).touch()
    built = Built(tmp_path / "liba.so", "quiet", (tmp_path / "a.c",), digest_in_library, tmp_path)
    with pytest.raises(BuildError) as failed:
        built.make_current()
    said = "is not built, and python -m quiet could not build it: it ended with exit code 3"
    assert str(failed.value) == f"{built.path} {said}"


def test_an_installed_package_builds_no_fmu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(native, "is_checkout", lambda: False)
    with pytest.raises(BadInputError, match="run hil fmu build in a checkout"):
        CliRunner().invoke(app, ["fmu", "build"], catch_exceptions=False, standalone_mode=False)


def test_a_library_built_in_another_way_is_taken_as_it_is(tmp_path, monkeypatch) -> None:
    path = tmp_path / "libother.so"
    path.write_bytes(WHEEL_HOST.path.read_bytes() + b"\0")
    monkeypatch.setattr(extension, "OTHER", str(path))
    extension.loaded.cache_clear()
    try:
        assert extension.loaded().sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
        path.unlink()
        extension.loaded.cache_clear()
        with pytest.raises(BuildError, match="unset WHEEL_HOST_LIBRARY"):
            extension.library()
    finally:
        extension.loaded.cache_clear()


def test_a_library_without_a_mark_says_nothing_of_its_sources(tmp_path: Path) -> None:
    (tmp_path / "lib.so").write_bytes(b"mecanum-hil sources of old")
    assert digest_in_library(tmp_path / "lib.so") is None


def test_a_recording_names_each_native_library(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    hil.run("circle_speed", set={"loop.duration_s": 0.1, "expect": []}, record=path)
    properties = read(path).properties
    for name, built in (("wheel_host", WHEEL_HOST), ("cosim", COSIM)):
        assert properties[f"{name}_sha256"] == hashlib.sha256(built.path.read_bytes()).hexdigest()
        assert properties[f"{name}_sources_sha256"] == built.digest()
    assert properties["fmu_sha256"] == archive.sha256(archive.place("mecanum", Path()))


def test_declarations_of_another_library_are_not_taken(tmp_path: Path) -> None:
    library = Path(shutil.copy(WHEEL_HOST.path, tmp_path))
    assert not are_written(library)
    write_declarations(library, HEADERS, TABLE)
    assert are_written(library)
    library.write_bytes(library.read_bytes().replace(str(WHEEL_HOST.digest()).encode(), b"0" * 64))
    assert not are_written(library)
    ffi = declared(library, HEADERS, TABLE)
    assert ffi.sizeof("wheel_view") == extension.library()[0].sizeof("wheel_view")
