"""Loading a scenario: finding it, stacking its layers, validating the result.

Layers, the later wins: built-in defaults, the chain of ``extends`` from its base, the scenario's file, the robot's own
file (--robot), the options of the command line (--mode, --link, --seed), --set.
"""

import functools
import numbers
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, cast

from hil.core import TEST_SUFFIX
from hil.core.errors import BadInputError, near, nearest
from hil.core.options import build, format_value
from hil.core.printable import command, seen_from_here
from hil.laws.law_registry import give_law
from hil.scenario import layers
from hil.scenario.baseline import find as find_baseline
from hil.scenario.baseline import is_baseline
from hil.scenario.layers import Given, Tree
from hil.scenario.scenario import Scenario, values
from hil.scenario.tables import Tables
from hil.scenario.toml_text import key_lines, parse, parse_value
from hil.scenario.validation import check, derived, following
from hil.scenario.values import is_path

BASE = "circle_speed"
"""The scenario that lends what a robot's own file does not have, where a command needs a whole one."""
SHIPPED_DIRECTORY = Path(__file__).parent / "shipped"
"""Short scenarios that go where defects are: what ``hil verify`` runs."""
ROBOT_TABLES = ("robot", "firmware", "device", "link", "realtime", "commission")
"""Tables that a robot's own file may hold, so that any scenario runs on it."""

_SUFFIX = ".toml"
_OPTIONS = {"mode": "loop.mode", "link": "link.url", "seed": "loop.seed"}
_SET = "--set"
_CHOICES = ("controller.law", "reference.kind", "plant.fmu", "device.driver")


class _File(NamedTuple):
    """A TOML file that was read: ``display`` is its name in messages, as the user wrote it."""

    path: Path
    display: str
    document: dict[str, object]
    lines: dict[layers.Path, int]

    def layer(self) -> Tree:
        """Return the file's tables as a layer; every value knows its file and line."""
        tables = {key: value for key, value in self.document.items() if key != "extends"}
        return layers.make_layer(tables, self.display, self.lines)


def shipped_scenarios() -> dict[str, str]:
    """Return the shipped scenarios by name, each with the first comment line of its file."""
    return dict(_titles())


@functools.cache
def _titles() -> dict[str, str]:
    return {
        path.stem: path.read_text("utf-8").partition("\n")[0].lstrip("# ").rstrip()
        for path in sorted(SHIPPED_DIRECTORY.glob(f"*{_SUFFIX}"))
        if not is_baseline(path)
    }


def load(
    name_or_path: str | Path,
    *,
    set: Mapping[str, object] | Sequence[str] = (),  # noqa: A002 - the name of the option
    robot: str | Path | None = None,
    mode: str | None = None,
    link: str | None = None,
    seed: int | None = None,
) -> Scenario:
    """Return a scenario, validated and frozen: a shipped one by its name, or a file by its path.

    A path has a slash or ends in ``.toml``. ``set`` is a mapping of dotted keys to values, or texts ``key=value``. The
    value in such a text is read as TOML, or as plain text if it is not TOML. A mapping may also give ``controller.law``
    as a class. A relative path in a file starts from the file's folder; one in ``set`` starts from the current folder.
    The scenario has its baseline, if there is one. Raises BadInputError, with one line for each problem.
    """
    return with_baseline(read(name_or_path, robot=robot).scenario(set=set, mode=mode, link=link, seed=seed))


def with_baseline(scenario: Scenario) -> Scenario:
    """Return a scenario with its baseline, if there is one. Raises BadInputError for a baseline that is wrong."""
    return replace(scenario, baseline=find_baseline(scenario.name, scenario.path, scenario.directory))


class Sources(NamedTuple):
    """The files of a scenario, read and stacked once, from which many scenarios can be made."""

    file: _File
    tree: Tree

    def scenario(
        self,
        *,
        set: Mapping[str, object] | Sequence[str] = (),  # noqa: A002 - the name of the option
        mode: str | None = None,
        link: str | None = None,
        seed: int | None = None,
        folder: Path | None = None,
    ) -> Scenario:
        """Return the scenario with these values over those of the files, as ``load``, but without its baseline.

        Relative paths in ``set`` start from ``folder``, by default the current one.
        """
        directory = self.file.path.parent
        tree = self.tree
        for option, choice in (("mode", mode), ("link", link), ("seed", seed)):
            if choice is not None:
                tree = layers.assign(tree, _OPTIONS[option], choice, f"--{option}")
        for key, value in _assignments(set):
            tree = layers.assign(tree, key, value, _SET)
        tree = layers.merge(derived(tree), _rebase(tree, folder or Path.cwd(), directory, only=_SET))
        tree = layers.merge(tree, following(tree, _our_files()))
        tables = check(tree, f"scenario {self.file.display}", directory)
        where = {layers.dotted(path): given.where for path, given in layers.leaves(tree)}
        return Scenario(
            **vars(tables),
            name=_stem(self.file.path),
            path=None if directory == SHIPPED_DIRECTORY else self.file.path,
            directory=directory,
            provenance={key: where.get(key, "default") for key, _ in values(tables)},
        )


def read(name_or_path: str | Path, *, robot: str | Path | None = None) -> Sources:
    """Read the files of a scenario. Raises BadInputError for one that cannot be read, and for a bad ``extends``."""
    file = _open_scenario(name_or_path, None)
    tree: Tree = {}
    for one in _chain(file):
        tree = layers.stack(tree, _rebase(one.layer(), one.path.parent, file.path.parent))
    if robot is not None:
        tree = layers.stack(tree, _robot_layer(Path(robot)))
    return Sources(file, tree)


def given(values: Mapping[str, object], sources: Mapping[str, str]) -> dict[str, dict[str, str]]:
    """Return a user's own values for a run: those that come from no shipped scenario and are no defaults.

    Both arguments go by dotted key, ``sources`` as the provenance of a Scenario. Each value is a text, with where it is
    ``from``. Faults and expectations are left out, and of a scenario that extends no shipped one all files are.
    """
    ours = _our_files()
    of_file = {key: where.rpartition(":")[0] for key, where in sources.items()}
    extends = any(file in ours for file in of_file.values())
    return {
        key: {"value": format_value(values[key]), "from": where}
        for key, where in sources.items()
        if key in values
        and not key.startswith(("expect.", "fault."))
        and (where.startswith("--") or (extends and of_file[key].endswith(_SUFFIX) and of_file[key] not in ours))
    }


def _our_files() -> set[str]:
    return {f"{name}{_SUFFIX}" for name in shipped_scenarios()}


def from_values(name: str, given: Mapping[str, object], sources: Mapping[str, str]) -> Scenario:
    """Return a scenario from its values by dotted key, as a recording holds them.

    ``sources`` say where each was given. It has no file and no baseline; relative paths start from the current folder.
    Raises OptionsError for values that this version does not understand.
    """
    document: dict[str, Any] = {}
    for key, value in given.items():
        if key.startswith(("controller.shadow", "service.recordings_days")):  # of earlier versions: they drove no robot
            continue
        *above, last = key.split(".")
        table = document
        for part in above:
            table = table.setdefault(part, {})
        table[last] = value
    for array in ("fault", "expect"):
        rows = document.get(array, [])
        document[array] = [rows[number] for number in sorted(rows, key=int)] if isinstance(rows, dict) else rows
    tables = build(Tables, cast("Mapping[str, object]", layers.plain(layers.make_layer(document, "the recording"))))
    return Scenario(**vars(tables), name=name, path=None, directory=Path.cwd(), provenance=dict(sources))


def set_texts(given: Mapping[str, object] | Sequence[str]) -> list[str]:
    """Return the ``set`` of ``load`` as the command line writes it: texts ``key=value``, the value in TOML."""
    if isinstance(given, Mapping):
        return [f"{key}={format_value(_plain_python(value))}" for key, value in given.items()]
    return [given] if isinstance(given, str) else list(given)


def _open_scenario(name: str | Path, extended_by: _File | None) -> _File:
    """Read a shipped scenario by name, or a file by its path, relative to the one that extends it."""
    text = str(name)
    prefix = f"scenario {text}" if extended_by is None else _extends(extended_by, text)
    if isinstance(name, str) and not is_path(name):
        known = shipped_scenarios()
        if name not in known:
            folder = Path.cwd() if extended_by is None else extended_by.path.parent
            hint = _meant(folder / name, known)
            hint = hint or f"{nearest(name, known)}; the path of a file ends in {_SUFFIX}"
            raise BadInputError(f"{prefix}: no shipped scenario has this name{hint}")
        return _read(SHIPPED_DIRECTORY / f"{name}{_SUFFIX}", f"{name}{_SUFFIX}", prefix)
    if extended_by is None:
        return _read(Path.cwd() / text, text, prefix)
    return _read(extended_by.path.parent / text, str(Path(extended_by.display).parent / text), prefix)


def _meant(path: Path, shipped: Iterable[str] = ()) -> str:
    """Return a hint for a scenario that is not there: files beside it or in the folder of its name, or a shipped one.

    Returns an empty text where none is similar.
    """
    if os.path.isdir(path):  # noqa: PTH112 - Path.is_dir raises in a folder that may not be read
        within = [command(seen_from_here(file)) for file in sorted(path.glob(f"*{TEST_SUFFIX}"))]
        return f"; this is a folder, which has {', '.join(within)}" if within else ""
    files = {_stem(file): file for file in path.parent.glob(f"*{_SUFFIX}") if not is_baseline(file)}
    found = near(_stem(path), [*files, *shipped])
    named = [f"the file {command(seen_from_here(files[one]))}" if one in files else repr(one) for one in found]
    return f"; did you mean {' or '.join(named)}?" if named else ""


def _stem(path: Path) -> str:
    return path.name.removesuffix(_SUFFIX).removesuffix(TEST_SUFFIX.removesuffix(_SUFFIX))


def _extends(file: _File, name: object) -> str:
    where = layers.place_in(file.display, file.lines, ("extends",))
    return f"scenario {where}: extends = {name!r}"


def _chain(scenario: _File) -> list[_File]:
    chain = [scenario]
    while (extends := chain[-1].document.get("extends")) is not None:
        if not isinstance(extends, str) or not extends:
            raise BadInputError(f"{_extends(chain[-1], extends)}; expected a shipped name or the path of a file")
        base = _open_scenario(extends, chain[-1])
        if base.path.resolve() in [file.path.resolve() for file in chain]:
            circle = " -> ".join(file.display for file in [*chain, base])
            raise BadInputError(f"{_extends(chain[-1], extends)} leads back to itself: {circle}; remove one of them")
        chain.append(base)
    return chain[::-1]


def _robot_layer(path: Path) -> Tree:
    file = _read(path, f"--robot {path}", f"--robot {path}")
    if not file.document:
        raise BadInputError(f"{file.display}: it holds nothing; expected the tables of a robot, such as [robot]")
    for key in file.document:
        if key not in ROBOT_TABLES:
            tables = ", ".join(f"[{table}]" for table in ROBOT_TABLES)
            raise BadInputError(
                f"{file.display}: {key!r} cannot be in a robot's file, which holds {tables}{nearest(key, ROBOT_TABLES)}"
            )
    return _rebase_motors(file.layer(), path.parent)


def _read(path: Path, display: str, prefix: str) -> _File:
    if is_baseline(path):
        raise BadInputError(f"{prefix}: this is the baseline of a scenario; name the scenario that stands beside it")
    try:
        text = path.read_text("utf-8-sig")
    except FileNotFoundError:
        raise BadInputError(f"{prefix}: there is no file {str(path)!r}{_meant(path)}") from None
    except OSError as error:
        raise BadInputError(f"{prefix}: {str(path)!r} cannot be read: {error.strerror}{_meant(path)}") from error
    except ValueError as error:  # not UTF-8, or a zero byte in the path
        raise BadInputError(f"{prefix}: {str(path)!r} cannot be read as TOML text in UTF-8: {error}") from error
    return _File(path, display, parse(text, prefix), key_lines(text))


def _assignments(given: Mapping[str, object] | Sequence[str]) -> list[tuple[str, object]]:
    """Return the keys and values of ``set``.

    The choice of a law, reference, FMU or driver drops the options of the one before, so it is applied first, wherever
    it stands on the command line.
    """
    if isinstance(given, Mapping):
        pairs = [(str(key), _plain_python(value)) for key, value in given.items()]
    else:
        pairs = [key_and_value(text) for text in ([given] if isinstance(given, str) else given)]
    for key, _ in pairs:
        if key == "extends":
            raise BadInputError(f"{_SET} extends: only a file can extend another; name that scenario instead")
    return sorted(pairs, key=lambda pair: pair[0] not in _CHOICES)


def key_and_value(text: str) -> tuple[str, object]:
    """Return key and value of a text ``key=value``, the value in TOML. Raises BadInputError for another form."""
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise BadInputError(f"{_SET} {text}: expected key=value, such as robot.mass_kg=24")
    return key.strip(), parse_value(value.strip())


def _plain_python(value: object) -> object:
    """Return a caller's value as TOML holds it: paths and classes as text, NumPy's numbers as Python's."""
    if isinstance(value, type):
        return give_law(value)
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, Mapping):
        return {str(key): _plain_python(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain_python(item) for item in value]
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return value
    return int(value) if isinstance(value, numbers.Integral) else float(value)


def _rebase(tree: Tree, source: Path, target: Path, only: str | None = None) -> Tree:
    """Make relative paths of files absolute unless they start from the scenario's own folder.

    The path in a driver's settings always becomes absolute, because the driver does not know the scenario.
    """
    tree = _rebase_motors(tree, source, only)
    if source == target:
        return tree
    for table, key, rebase in (
        ("plant", "fmu", _rebased_file),
        ("controller", "law", _rebased_law),
        ("reference", "file", _rebased_file),
    ):
        node = tree.get(table)
        given = node.get(key) if isinstance(node, dict) else None
        if isinstance(given, Given) and only in (None, given.where):
            tree = layers.merge(tree, {table: {key: Given(rebase(given.value, source), given.where)}})
    return tree


def _rebase_motors(tree: Tree, source: Path, only: str | None = None) -> Tree:
    device = tree.get("device")
    motors = device.get("motors") if isinstance(device, dict) else None
    given = motors.get("file") if isinstance(motors, dict) else None
    if not isinstance(given, Given) or only not in (None, given.where) or not isinstance(given.value, str):
        return tree
    moved = Given(str((source / given.value).absolute()), given.where)
    return layers.merge(tree, {"device": {"motors": {"file": moved}}})


def _rebased_file(value: object, source: Path) -> object:
    return str(source / value) if isinstance(value, str) and is_path(value) else value


def _rebased_law(value: object, source: Path) -> object:
    file, colon, name = value.rpartition(":") if isinstance(value, str) else ("", "", "")
    return f"{source / file}{colon}{name}" if is_path(file) and file.endswith(".py") else value
