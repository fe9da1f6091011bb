"""The FMUs for all platforms: what format and exports each binary has, and that other processors get the same bits."""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from pathlib import Path
from unittest import mock

import fmpy
import lief
import numpy as np
import pytest

import plant_fmu
from plant_fmu import platforms
from plant_fmu.sources import DESCRIPTIONS, SOURCES
from tests.support import once
from tools.build import compiler
from tools.build import fmu as build

VERSIONS = sorted(DESCRIPTIONS)
# Zig makes the C library of each platform first: for Windows that takes 65 s of processor time, for the others 5 s.
# So make nightly links the library for Windows; otherwise its sources are compiled.
TARGETS = {
    name: target
    for name, target in platforms.ZIG_TARGETS.items()
    if os.environ.get("HIL_EXAMPLES") == "thorough" or name != "x86_64-windows"
}
ALL_FOLDERS = {
    2: {
        "linux64": "x86_64-linux",
        "aarch64-linux": "aarch64-linux",
        "win64": "x86_64-windows",
        "darwin64": "universal-darwin",
        "aarch64-darwin": "aarch64-darwin",
    },
    3: {name: name for name in platforms.ZIG_TARGETS},
}
FOLDERS = {
    fmi: {key: name for key, name in names.items() if name == "universal-darwin" or name in TARGETS}
    for fmi, names in ALL_FOLDERS.items()
}
SUFFIX = {"linux": ".so", "windows": ".dll", "darwin": ".dylib"}
BINARIES = [(fmi, folder) for fmi in VERSIONS for folder in FOLDERS[fmi]]
SYSROOT = {"aarch64": Path("/usr/aarch64-linux-gnu"), "x86_64": Path("/usr/x86_64-linux-gnu")}
pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("ziglang") is None,
    reason=f"cross-compiling needs zig: pip install {compiler.ZIG_REQUIREMENT}",
)


@pytest.fixture(scope="module")
def release() -> dict[int, Path]:
    """Give the FMU for all platforms of each FMI version."""
    return once.made("release", _build_release)


def _build_release(folder: Path) -> dict[int, Path]:
    with mock.patch.object(platforms, "ZIG_TARGETS", TARGETS):
        return dict(zip(VERSIONS, build.build_all(folder, all_platforms=True), strict=True))


def library(fmu: Path, folder: str) -> bytes:
    """Return what is in one folder of the binaries; there is one file."""
    with zipfile.ZipFile(fmu) as archive:
        [name] = [name for name in archive.namelist() if name.startswith(f"binaries/{folder}/")]
        return archive.read(name)


def slices(content: bytes) -> Sequence[lief.Binary]:
    """Parse a library: one binary a processor, alive as long as the result is."""
    if content[:4] in {b"\xcf\xfa\xed\xfe", b"\xca\xfe\xba\xbe"}:
        return lief.MachO.parse(list(content))
    return [lief.parse(list(content))]


def functions_of_the_standard(fmi: int) -> set[str]:
    """Return what a co-simulation library has to export, from the standard's own header."""
    text = (Path(fmpy.__file__).parent / "c-code" / f"fmi{fmi}Functions.h").read_text(encoding="utf-8")
    if fmi == 3:
        return set(re.findall(r"^FMI3_Export\s+\w+\s+(fmi3\w+);", text, re.MULTILINE))
    common, _model_exchange, co_simulation = text.split("fmi2Version")[0].split("Functions for FMI2 for ")[0:3]
    return set(re.findall(r"^#define (fmi2\w+)\s+fmi2FullName", common + co_simulation, re.MULTILINE)) - {
        "fmi2FullName"
    }


def test_each_archive_has_a_binary_for_every_platform(release: dict[int, Path]) -> None:
    for fmi, fmu in release.items():
        with zipfile.ZipFile(fmu) as archive:
            found = {name for name in archive.namelist() if name.startswith("binaries/")}
        expected = {f"binaries/{folder}/mecanum{SUFFIX[name.split('-')[1]]}" for folder, name in FOLDERS[fmi].items()}
        assert found == expected


@pytest.mark.parametrize(("fmi", "folder"), BINARIES)
def test_a_binary_is_of_its_platform(release: dict[int, Path], fmi: int, folder: str) -> None:
    machine, system = FOLDERS[fmi][folder].split("-")
    binaries = slices(library(release[fmi], folder))
    formats = {"linux": lief.ELF.Binary, "windows": lief.PE.Binary, "darwin": lief.MachO.Binary}
    assert all(isinstance(binary, formats[system]) for binary in binaries)
    machines = {
        lief.Header.ARCHITECTURES.X86_64: "x86_64",
        lief.Header.ARCHITECTURES.ARM64: "aarch64",
    }
    found = {machines[binary.abstract.header.architecture] for binary in binaries}
    assert found == ({"x86_64", "aarch64"} if machine == "universal" else {machine})
    assert all(binary.abstract.header.is_64 for binary in binaries)


@pytest.mark.parametrize(("fmi", "folder"), BINARIES)
def test_a_binary_exports_the_functions_of_every_fmi_version_and_no_others(
    release: dict[int, Path], fmi: int, folder: str
) -> None:
    expected = set().union(*map(functions_of_the_standard, VERSIONS))
    binaries = slices(library(release[fmi], folder))
    for binary in binaries:
        if isinstance(binary, lief.MachO.Binary):
            # The linker's own marks besides; a C name has an underscore before it.
            exported = {str(symbol.name).removeprefix("_") for symbol in binary.exported_symbols}
            exported -= {"_mh_dylib_header", "__dso_handle"}
        else:
            exported = {function.name for function in binary.abstract.exported_functions}
        assert exported == expected


def test_the_sources_compile_for_windows_with_the_functions_of_every_fmi_version_as_exports(tmp_path: Path) -> None:
    target = platforms.ZIG_TARGETS["x86_64-windows"]
    command = [*compiler.zig(), "-target", target, *compiler.FLAGS, *(f"-I{folder}" for folder in build._INCLUDE)]
    exported = set()
    for source in SOURCES:
        made = tmp_path / f"{source.stem}.obj"
        subprocess.run([*command, "-c", str(source), "-o", str(made)], cwd=tmp_path, check=True)
        exported |= set(re.findall(rb"-export:(\w+)", made.read_bytes()))  # what it asks of the linker
    assert {name.decode() for name in exported} == set().union(*map(functions_of_the_standard, VERSIONS))


@pytest.mark.parametrize(("fmi", "folder"), BINARIES)
def test_a_binary_needs_nothing_but_the_c_library_of_an_old_system(
    release: dict[int, Path], fmi: int, folder: str
) -> None:
    binaries = slices(library(release[fmi], folder))
    for binary in binaries:
        if isinstance(binary, lief.ELF.Binary):
            assert set(binary.libraries) <= {"libc.so.6", "libm.so.6", "ld-linux-aarch64.so.1"}
            needed = [mark.name for file in binary.symbols_version_requirement for mark in file.get_auxiliary_symbols()]
            versions = [tuple(map(int, name.removeprefix("GLIBC_").split("."))) for name in needed]
            assert max(versions) <= (2, 17)
            assert not any(section.name in {".symtab", ".debug_info"} for section in binary.sections)
        elif isinstance(binary, lief.PE.Binary):
            assert all(name == "KERNEL32.dll" or name.startswith("api-ms-win-crt-") for name in binary.libraries)
        else:
            assert [file.name for file in binary.libraries] == ["@rpath/mecanum.dylib", "/usr/lib/libSystem.B.dylib"]
            assert binary.build_version.minos == [11, 0, 0]
            if binary.header.cpu_type == lief.MachO.Header.CPU_TYPE.ARM64:
                assert binary.has_code_signature  # without one an Apple processor loads nothing


def test_the_universal_binary_has_both_processors_libraries(release: dict[int, Path]) -> None:
    both = library(release[2], "darwin64")
    alone = library(release[2], "aarch64-darwin")
    binaries = slices(both)
    [arm] = [binary for binary in binaries if binary.header.cpu_type == lief.MachO.Header.CPU_TYPE.ARM64]
    assert both[arm.fat_offset : arm.fat_offset + len(alone)] == alone


def test_the_archives_are_the_same_wherever_they_are_built(release: dict[int, Path], tmp_path: Path) -> None:
    """Another folder of sources, and none of what zig made of the first ones is used again."""
    shutil.copytree(plant_fmu.path().parent, tmp_path / "plant_fmu", ignore=shutil.ignore_patterns("*.fmu"))
    code = (
        f"from plant_fmu import platforms; platforms.ZIG_TARGETS = {TARGETS}; from tools.build import fmu; fmu.main()"
    )
    command = [sys.executable, "-c", code, "--all-platforms", "--out", str(tmp_path)]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    for archive in release.values():
        assert (tmp_path / archive.name).read_bytes() == archive.read_bytes()


def test_fmpy_runs_the_archive_for_all_platforms_as_it_runs_our_own(release: dict[int, Path]) -> None:
    start = {"wheel.fl.torque_n_m": 1.0, "start_vx_m_s": 0.5}
    for fmi, fmu in release.items():
        ours = build.build(fmi=fmi)
        one, two = (fmpy.simulate_fmu(str(path), stop_time=0.1, start_values=start) for path in (fmu, ours))
        assert one.dtype == two.dtype
        for name in one.dtype.names:
            np.testing.assert_allclose(one[name], two[name], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("fmi", VERSIONS)
def test_arm_and_x86_compute_the_same_bits(release: dict[int, Path], fmi: int, tmp_path: Path) -> None:
    said = [_steps(release[fmi], fmi, machine, tmp_path) for machine in ("x86_64", "aarch64")]
    assert len({line.split()[2] for line in said[0].splitlines()}) > 1000  # the robot moves
    assert said[0] == said[1]


def _steps(fmu: Path, fmi: int, machine: str, folder: Path) -> str:
    """Run 200 steps of the library for a processor, here or in an emulator, and return all outputs as bits."""
    runner: list[str] = []
    if platforms.this_platform() != f"{machine}-linux":
        emulator = shutil.which(f"qemu-{machine}")
        if not emulator or not SYSROOT[machine].is_dir():
            pytest.skip("running another processor's binary needs qemu-user and libc6-arm64-cross from Debian")
        runner = [emulator, "-L", str(SYSROOT[machine])]
    names = {name: key for key, name in FOLDERS[fmi].items()}
    shared = folder / f"{machine}.so"
    shared.write_bytes(library(fmu, names[f"{machine}-linux"]))
    program = folder / f"fmu_steps_{machine}"
    source = Path(__file__).with_name("fmu_steps.c")
    command = [*compiler.zig(), "-target", platforms.ZIG_TARGETS[f"{machine}-linux"], *compiler.FLAGS]
    # From there, as the libraries were made: zig would make its C library anew for another folder.
    subprocess.run([*command, str(source.absolute()), "-o", str(program), "-ldl"], cwd=folder, check=True)
    description = fmpy.read_model_description(str(fmu))
    real = {"Real", "Float64"}
    variables = [v for v in description.modelVariables if v.causality in {"input", "output"}]
    lists = [
        sorted((v for v in variables if v.causality == "input"), key=lambda v: v.name == "drive.enabled"),
        [v for v in variables if v.causality == "output" and v.type in real],
        [v for v in variables if v.causality == "output" and v.type in {"Integer", "Int32"}],
    ]
    token = description.guid if fmi == 2 else description.instantiationToken
    words = [str(shared), str(fmi), token, "200", *(",".join(str(v.valueReference) for v in each) for each in lists)]
    done = subprocess.run([*runner, str(program), *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout
