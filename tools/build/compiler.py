"""Finds a C compiler and makes shared libraries with it.

The order is ``$CC``; cc, gcc, clang; zig. Zig comes as a Python package (``ziglang``), brings a C library for every
target, and is what a machine without a compiler builds with. On Windows zig comes before the others: a gcc or clang
that happens to be on the PATH there may miss its headers, or make code for another word size. Zig keeps its results in
a cache of its own, in the user's cache folder or in ``ZIG_GLOBAL_CACHE_DIR``.

``python -m tools.build.compiler`` prints the version of the compiler that a build would use.
"""

import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

from firmware_protocol.built import FLAGS, BuildError, Built, mark

ZIG_REQUIREMENT = "ziglang==0.17.1"  # one version, so that everyone's cross-compiled binaries are the same
_ON_THE_PATH = ("cc", "gcc", "clang")
_OF_PYTHON = re.compile(r"^(?:WHEEL_IMPORTED .*?(\w+);|\w[\w ]*[ *](\w+)\(.*\);)$", re.MULTILINE)


def compiler(cc: str | None = None) -> list[str]:
    """Return the command of the C compiler: ``cc``, ``$CC``, or what this machine has.

    A command may have several words, such as ``ccache gcc``. Raises BuildError when there is none.
    """
    given = cc or os.environ.get("CC")
    if given:
        words = [given] if shutil.which(given) else shlex.split(given, posix=sys.platform != "win32")
        if found := shutil.which(words[0]):
            return [str(Path(found).absolute()), *words[1:]]
        raise BuildError(f"the C compiler {words[0]!r} (from CC) is not there; set CC to one, or leave it empty")
    system, zig = _on_the_path(), _zig()
    if command := (zig or system) if sys.platform == "win32" else (system or zig):
        return command
    raise BuildError(
        f"no C compiler found (tried {', '.join(_ON_THE_PATH)} and zig); "
        f"install one, for example gcc, run pip install {ZIG_REQUIREMENT}, or set CC"
    )


def wants_zig() -> bool:
    """Return whether this machine compiles with zig, so that whoever builds here has to install it first."""
    return not os.environ.get("CC") and (sys.platform == "win32" or not _on_the_path())


def zig() -> list[str]:
    """Return the command of zig's C compiler, for the targets of other machines. Raises BuildError without it."""
    if command := _zig():
        return command
    raise BuildError(
        f"zig is not installed, and only zig compiles for other machines; run pip install {ZIG_REQUIREMENT}"
    )


def version(command: Sequence[str]) -> str:
    """Return the compiler's description of itself. Raises BuildError when it cannot be run."""
    return _run([*command, "--version"]).splitlines()[0]


def compile_shared(
    sources: Iterable[Path],
    library: Path,
    include: Sequence[Path] = (),
    cc: str | None = None,
    flags: Sequence[str] = (),
    zig_target: str | None = None,
    built: Built | None = None,
) -> None:
    """Compile C sources into a shared library, whole or not at all.

    With ``built`` its own flags count, and the hash of its sources goes into the library.
    With ``zig_target``, such as ``aarch64-linux-gnu.2.17``, zig compiles for that machine, and the result depends on
    nothing but the sources, the flags, the library's name and zig's version. Raises BuildError with what the
    compiler said.
    """
    command = [*zig(), "-target", zig_target] if zig_target else compiler(cc)
    command += [*(FLAGS if built is None else built.flags), *flags, "-shared"]
    # For quoted headers alone: hil/plant/windows.h would hide the <windows.h> of Windows.
    command += [f"-iquote{folder.absolute()}" for folder in include] + [str(source.absolute()) for source in sources]
    # Before compiling: sources that change meanwhile make the library one that is not current.
    digest = None if built is None else built.digest()
    if library.suffix == ".dylib":
        command += [f"-Wl,-install_name,@rpath/{library.name}", "-Wl,-x"]
    if library.suffix not in (".dll", ".pyd"):
        command += ["-fPIC", "-lm"]
    of_python = None if built is None else built.of_python
    if of_python is not None and ("macos" in zig_target if zig_target else sys.platform == "darwin"):
        command.append("-Wl,-undefined,dynamic_lookup")
    # The file has its own name from the start, because linkers write it into the library.
    try:
        with tempfile.TemporaryDirectory(dir=library.parent, prefix=f".{library.name}.") as folder:
            made = Path(folder).absolute() / library.name
            if digest is not None:
                (marked := made.with_name("built_from.c")).write_text(mark(digest), encoding="ascii")
                command.append(str(marked))
            if of_python is not None and library.suffix == ".pyd":
                command.append(str(_import_library(of_python, made.parent)))
            # Not from the user's folder: below an environment's, zig makes its C libraries anew for that folder alone.
            _run([*command, "-o", str(made)], made.parent)
            made.replace(library)
    except OSError as error:
        raise BuildError(f"{library}: cannot be written ({error.strerror}); make its folder writable") from error


def _import_library(header: Path, folder: Path) -> Path:
    """Make the import library of what a header declares of the stable ABI, for Windows. Raises BuildError."""
    found = _OF_PYTHON.findall(header.read_text(encoding="utf-8"))
    names = [f"{data} DATA" if data else function for data, function in found]
    (names_file := folder / "python3.def").write_text("\n".join(["LIBRARY python3.dll", "EXPORTS", *names]) + "\n")
    made = folder / "python3.lib"
    command = zig()
    tool = [*command[: command.index("cc")], "dlltool", "-m", "i386:x86-64"]
    _run([*tool, "-d", str(names_file), "-D", "python3.dll", "-l", str(made)])
    return made


def compile_object(source: Path, target: Path, include: Sequence[Path], flags: Sequence[str]) -> None:
    """Compile one C source into an object. Raises BuildError with what the compiler said."""
    _run([*compiler(), *flags, *(f"-I{folder}" for folder in include), "-c", str(source), "-o", str(target)])


def link_shared(objects: Iterable[Path], library: Path) -> None:
    """Link objects into a shared library. Raises BuildError with what the linker said."""
    mathematics = [] if library.suffix == ".dll" else ["-lm"]
    _run([*compiler(), "-shared", "-o", str(library), *map(str, objects), *mathematics])


def _on_the_path() -> list[str]:
    found = (shutil.which(name) for name in _ON_THE_PATH)
    return next(([path] for path in found if path), [])


def _zig() -> list[str]:
    if importlib.util.find_spec("ziglang") is None:
        return []
    # Zig's own default is the very processor that it runs on, and the library may move to an older one. Stripped (-s),
    # because the debug information has the paths of this machine.
    return [sys.executable, "-m", "ziglang", "cc", "-mcpu=baseline", "-s"]


def _run(command: Sequence[str], folder: Path | None = None) -> str:
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, errors="replace", check=False)
    except OSError as error:
        raise BuildError(f"{shlex.join(command)} cannot be run ({error.strerror}); set CC to a C compiler") from error
    if done.returncode != 0:
        raise BuildError(f"{shlex.join(command)} failed:\n{done.stderr}")
    return done.stdout


if __name__ == "__main__":
    try:
        print(version(compiler()))
    except BuildError as problem:
        sys.exit(str(problem))
