"""The hash of a law's code: it identifies in a recording which code drove the robot.

It covers the law's file and every module that the file imports, directly or indirectly, from the same place: from its
folder, or from its package for a law in a package. Other modules, such as NumPy, are not covered.
"""

import ast
import hashlib
from collections.abc import Iterator
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

_OURS = "hil"
_held: dict[Path, bytes] = {}
"""Content of modules when first read. Python imports a module once, so later changes of its file have no effect."""


class _Place(NamedTuple):
    """Where modules are searched: below a folder, either those of one package or all except ours."""

    folder: Path
    package: str | None

    def file_of(self, module: str) -> Path | None:
        """Return the file of a module, given its dotted name; None if the module is not in this place."""
        top = module.partition(".")[0]
        if top != self.package if self.package is not None else top == _OURS:
            return None
        path = self.folder.joinpath(*module.split("."))
        files = (path / "__init__.py", *(path.with_name(path.name + suffix) for suffix in (".py", *EXTENSION_SUFFIXES)))
        return next((file for file in files if file.is_file()), None)


def code_of_file(file: Path) -> str | None:
    """Return the SHA-256 of a law in a file, in hex; None if the file cannot be read.

    For a file that imports nothing from its folder it is the hash that ``sha256sum`` prints.
    """
    # Only this file is executed again each time the law is made.
    _held.pop(file, None)
    return _digest(_Place(file.parent, None), file, file.stem)


def code_of_module(module: str | None) -> str | None:
    """Return the SHA-256 of a law in a module, in hex; None for None, or if its source is missing. Executes nothing."""
    if module is None:
        return None
    package = module.partition(".")[0]
    try:
        found = find_spec(package)
    except (ImportError, ValueError):
        return None
    if found is None or found.origin is None:
        return None
    origin = Path(found.origin)
    folder = origin.parents[1] if found.submodule_search_locations is not None else origin.parent
    place = _Place(folder, package)
    file = place.file_of(module)
    return None if file is None else _digest(place, file, module)


def forget(module: str) -> None:
    """Discard the stored content of a module, because the module will be executed again."""
    for file in [file for file in _held if file.stem == module.rpartition(".")[2]]:
        del _held[file]


def _digest(place: _Place, first: Path, name: str) -> str | None:
    files: dict[Path, str] = {}
    pending = [(first, name)]
    try:
        while pending:
            file, module = pending.pop()
            if file in files:
                continue
            content = _content(file)
            files[file] = hashlib.sha256(content).hexdigest()
            if file.suffix == ".py":
                imported = _imports(content, module, is_package=file.name == "__init__.py")
                pending += [(other, name) for name in imported if (other := place.file_of(name)) is not None]
    except OSError:
        return None
    if len(files) == 1:
        return files[first]
    rows = sorted(f"{file.relative_to(place.folder).as_posix()} {digest}" for file, digest in files.items())
    return hashlib.sha256("\n".join(rows).encode()).hexdigest()


def _content(file: Path) -> bytes:
    if file not in _held:
        _held[file] = file.read_bytes()
    return _held[file]


def _imports(content: bytes, module: str, *, is_package: bool) -> Iterator[str]:
    """Yield the dotted names that a module may import, except those that only a type checker reads."""
    package = module if is_package else module.rpartition(".")[0]
    try:
        waiting: list[ast.AST] = [ast.parse(content)]
    except (SyntaxError, ValueError):
        return
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            source = ".".join([*above, *([node.module] if node.module else [])])
            yield source
            yield from (f"{source}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            waiting += node.orelse
        else:
            waiting += (child for child in ast.iter_child_nodes(node) if not isinstance(child, ast.expr))
