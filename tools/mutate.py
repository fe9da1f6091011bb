"""Mutation testing of the C: does a test notice when one place of the firmware, shim or plant is a little wrong?

``python -m tools.mutate`` changes one place at a time in a copy of the checkout, builds there the libraries and FMUs
that hold it, and runs the tests that are near to the file, then those of its room, until one fails. Survivors are tried
once more with AddressSanitizer, if the compiler has it: a read beyond an array may read the right value by chance.
It prints the survivors and a table of the rooms, which are the folders of the C. It fails when a survivor is not in
``equivalent_mutants.toml``, which says why a change is none; a sample, as ``--sample 20`` takes at random, is printed
for somebody to look at, and fails for none. Another ``--seed`` takes others.
"""

import os
import subprocess
import sys
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import plant_fmu
from firmware_protocol.built import FIRMWARE_FLAGS, FLAGS, SOURCES, WHEEL_HOST, Built, mark
from hil.plant import built as shim
from plant_fmu import sources as plant
from plant_fmu.sources import comment_of
from tools.build import pack
from tools.build.compiler import compiler
from tools.covered_functions import CoveredFunctions
from tools.mutants import ROOT, Copy, Key, Mutant, NoMutantError, chosen, equivalent, options, print_stale, try_all
from tools.mutants_of_c import PLACES, mutants, near_tests

# An index beyond an array ends the tests as well.
_TRAP = ("-fsanitize=undefined,float-cast-overflow", "-fsanitize-undefined-trap-on-error")
_ADDRESS = ("-fsanitize=address", "-fno-omit-frame-pointer")
# Whoever builds notices a warning; only a warning shows a function that forgets its return value.
_NOTICED = tuple(f"-Werror={one}" for one in ("return-type", "int-conversion", "incompatible-pointer-types"))


class _Part(NamedTuple):
    """A library of this project, and what holds it: itself or FMUs."""

    held_by: tuple[Built, ...]
    sources: tuple[Path, ...]
    include: tuple[Path, ...]
    flags: tuple[str, ...]


_PARTS = (
    _Part((WHEEL_HOST,), SOURCES, (), FIRMWARE_FLAGS),
    _Part((shim.COSIM,), shim.SOURCES, shim.INCLUDE, FLAGS),
    _Part(tuple(shim.FMUS[plant_fmu.path(fmi)] for fmi in (2, 3)), plant.SOURCES, (plant.HERE, plant.GENERATED), FLAGS),
)


class _Build:
    """Builds a library in a copy of the checkout, compiling only what has changed."""

    def __init__(self, part: _Part, copy: Path, sanitizer: tuple[str, ...]) -> None:
        self._part = part
        self._copy = copy
        self._sanitizer = sanitizer
        self._folder = copy / "build" / "mutants" / part.held_by[0].path.stem
        self._folder.mkdir(parents=True)
        self._objects = {source.name: self._compile(source.name, sanitizer) for source in part.sources}

    def put(self, changed: Mapping[str, Path]) -> None:
        """Put the library of the present sources into the copy, with these objects instead of the first ones."""
        for built in self._part.held_by:
            here = [self._there(source) for source in built.sources]
            built_here = built._replace(path=self._there(built.path), sources=tuple(here), root=self._copy)
            (marked := self._folder / "built_from.c").write_text(mark(built_here.digest() or ""), encoding="ascii")
            library = self._folder / "made.so"
            objects = map(str, (self._objects | dict(changed)).values())
            command = [*compiler(), *self._sanitizer, "-shared", "-fPIC", "-o", str(library), *objects, str(marked)]
            subprocess.run([*command, "-lm"], check=True)
            if built.path.suffix != ".fmu":
                library.replace(built_here.path)
                continue
            with zipfile.ZipFile(built_here.path) as archive:
                members = {name: archive.read(name) for name in archive.namelist()}
            members |= {name: library.read_bytes() for name in members if name.startswith("binaries/")}
            inputs = (comment_of(built_here.path) or "").split()[0]
            pack.write(members, built_here.path, f"{inputs} {built_here.digest()}")

    def compiled(self, name: str) -> dict[str, Path]:
        """Return the object of a file as it is now in the copy. Raises NoMutantError if it does not compile."""
        return {name: self._compile(name, self._sanitizer, "changed")}

    def code(self, name: str) -> bytes:
        """Return the machine code that a user gets of a file as it is now in the copy."""
        return self._compile(name, (), "plain").read_bytes()

    def _there(self, path: Path) -> Path:
        return self._copy / path.relative_to(ROOT)

    def _compile(self, name: str, sanitizer: tuple[str, ...], kind: str = "first") -> Path:
        source = next(one for one in self._part.sources if one.name == name)
        target = self._folder / f"{source.stem}.{kind}.o"
        flags = [flag for flag in self._part.flags if not flag.startswith("-W")]
        flags += ["-w", "-Wreturn-type", *_NOTICED, *sanitizer]
        flags += [f"-iquote{self._there(folder)}" for folder in self._part.include]
        command = [*compiler(), *flags, "-fPIC", "-c", str(self._there(source)), "-o", str(target)]
        if subprocess.run(command, capture_output=True, check=False).returncode != 0:
            raise NoMutantError
        return target


class NativeCopy(Copy):
    """A copy of the checkout whose libraries hold the mutant of a C file."""

    def __init__(
        self,
        folder: Path,
        seconds: Mapping[str, float],
        sanitizer: tuple[str, ...] = _TRAP,
        preload: Path | None = None,
    ) -> None:
        """``preload``: a library that has to be in the process before the mutant."""
        variables = {} if preload is None else {"LD_PRELOAD": str(preload), "ASAN_OPTIONS": "detect_leaks=0"}
        super().__init__(folder, lambda mutant: near_tests(mutant, seconds), variables)
        self._seconds = seconds
        self._sanitizer = sanitizer
        self._builds: dict[str, _Build] = {}
        self._second: NativeCopy | None = None

    def close(self) -> None:
        super().close()
        if self._second is not None:
            self._second.close()

    @contextmanager
    def changed(self, mutant: Mutant) -> Iterator[None]:
        build = self._build(mutant)
        name = Path(mutant.file).name
        with super().changed(mutant):
            if build is None:
                self._build_mujoco()
            else:
                build.put(build.compiled(name))
            yield
        if build is not None:
            build.put({})

    def noticed_by(self, mutant: Mutant, *, near: bool, quick: bool = False) -> str | None:
        noticed = super().noticed_by(mutant, near=near, quick=quick)
        if noticed is None and (build := self._build(mutant)):
            name = Path(mutant.file).name
            before = build.code(name)
            with super().changed(mutant):
                if build.code(name) == before:
                    raise NoMutantError
        if noticed is None and not near and self._sanitizer == _TRAP and (library := address_sanitizer()):
            self._second = self._second or NativeCopy(
                self.folder / "build" / "addresses", self._seconds, _ADDRESS, library
            )
            noticed = self._second.noticed_by(mutant, near=True)
        return noticed

    def _build(self, mutant: Mutant) -> _Build | None:
        """Return what builds the library of a file; None for the plant of MuJoCo, whose script does."""
        for part in _PARTS:
            if ROOT / mutant.file in part.sources:
                name = part.held_by[0].path.name
                if name not in self._builds:
                    self._builds[name] = _Build(part, self.folder, self._sanitizer)
                return self._builds[name]
        return None

    def _build_mujoco(self) -> None:
        command = [sys.executable, "-m", "tools.build.mujoco_fmu"]
        variables = os.environ | {"PYTHONPATH": str(self.folder)}
        if subprocess.run(command, cwd=self.folder, env=variables, capture_output=True, check=False).returncode != 0:
            raise NoMutantError


def address_sanitizer() -> Path | None:
    """Return the library of AddressSanitizer; None where the compiler has none that can be loaded first."""
    asked = [*compiler(), "-print-file-name=libasan.so"]
    found = Path(subprocess.run(asked, capture_output=True, text=True, check=False).stdout.strip())
    return found if found.is_absolute() else None


def keys() -> dict[Mutant, Key]:
    """Return every mutant, and by what it is listed: the name of its file, and the line before its own."""
    found = {}
    for name, file in PLACES.items():
        text = (ROOT / file).read_text(encoding="utf-8")
        lines = ["", *text.splitlines()]
        for mutant in mutants(file, text):
            found[mutant] = Key(name, lines[mutant.line - 1].strip(), mutant.before, mutant.after)
    return found


def main() -> int:
    """Try mutants, and print what survives, a table, and what is listed in vain."""
    parser = options("tools.mutate", __doc__)
    parser.add_argument("--file", choices=PLACES, action="append", help="only of this file; may be repeated")
    arguments = parser.parse_args()
    every = keys()
    known, stale = equivalent("mutant", "follows", every)
    of_files = {PLACES[name] for name in arguments.file or PLACES}
    some = chosen([one for one in every if one.file in of_files and one not in known], arguments)
    seconds = CoveredFunctions(arguments.covered).seconds
    survivors = try_all(some, lambda folder: NativeCopy(folder, seconds), arguments)
    print_stale(stale)
    return int(bool(stale or (survivors and arguments.sample is None)))


if __name__ == "__main__":
    sys.exit(main())
