"""Options: a frozen dataclass defines a table of a scenario, or the options of a law or a reference.

Its fields give the names, types and defaults. ``Annotated`` adds, in any order: a ``Range``, an explanation of the
option, an ``Expected`` text for messages, and functions that return the checked value or raise ValueError:

    @dataclass(frozen=True)
    class Options:
        rate_hz: Annotated[float, Range(ge=0.1, le=1000), "fixes a second"] = 10.0

``__post_init__`` may raise ValueError for options that contradict each other. ``build`` makes the dataclass from the
values of a TOML table. It checks float (an int is converted), int, bool, str, Literal, tuples, mappings, ``X | None``
and dataclasses; fields of other types are not checked. A function does not see None.
"""

import functools
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

from hil.core.errors import BadInputError, near

T = TypeVar("T")
Path = tuple[str, ...]

ABSENT = object()
"""The value of a ``Problem`` that has no value to show."""
OTHERS = object()
"""In ``Annotated``: marks the mapping field that receives all keys of the table that are not fields."""


@dataclass(frozen=True)
class Range:
    """Bounds of a number: ``gt`` exclusive, ``ge`` and ``le`` inclusive. NaN is never within."""

    gt: float | None = None
    ge: float | None = None
    le: float | None = None
    infinite: bool = False

    def holds(self, value: float) -> bool:
        """Return whether a number is within the bounds."""
        return (
            (self.gt is None or value > self.gt)
            and (self.ge is None or value >= self.ge)
            and (self.le is None or value <= self.le)
            and not math.isnan(value)
        )

    def __str__(self) -> str:
        """Return the bounds in words that follow "a number", for example " from 0 to 1"."""
        if self.gt is not None:
            return f" greater than {self.gt:.12g}" + ("" if self.le is None else f" and at most {self.le:.12g}")
        if self.ge is not None:
            return f" of at least {self.ge:.12g}" if self.le is None else f" from {self.ge:.12g} to {self.le:.12g}"
        return ""


def size_words(number: float) -> str | None:
    """Return the expected size if a number is so large or small that its powers overflow or become 0; else None."""
    if abs(number) > _MOST:
        return f"a size of at most {_MOST:g}"
    return f"0, or a size of at least {_LEAST:g}" if 0.0 < abs(number) < _LEAST else None


class Expected(NamedTuple):
    """In ``Annotated``: the words after "expected" in messages, or what returns them, in place of those by the type."""

    words: str | Callable[[], str]


POSITIVE, NOT_NEGATIVE = Range(gt=0), Range(ge=0)
_LEAST, _MOST = 1e-30, 1e30
RATE = Range(gt=0, le=1000)
"""A gain [1/s] or a bandwidth [rad/s] of a loop with ticks of 1 ms and more: above it nothing is stable."""


_UNIT_PART = re.compile(r"(?:1|n|m|s|rad|a|v|kg|ohm|h)\d?")
_OTHER_UNITS = {
    "m": ("m", {"millimetres": 1e-3, "centimetres": 1e-2}),
    "m_s": ("m/s", {"millimetres a second": 1e-3}),
    "m_s2": ("m/s²", {"millimetres a second squared": 1e-3}),
    "rad": ("rad", {"degrees": math.pi / 180.0}),
    "rad_s": ("rad/s", {"turns a minute": math.tau / 60.0, "degrees a second": math.pi / 180.0}),
    "s": ("s", {"milliseconds": 1e-3, "microseconds": 1e-6}),
    "kg": ("kg", {"grams": 1e-3}),
    "kg_m2": ("kg·m²", {"kg·cm²": 1e-4, "g·cm²": 1e-7}),
    "n_m": ("N·m", {"N·mm": 1e-3, "N·cm": 1e-2}),
    "a": ("A", {"milliamperes": 1e-3}),
    "v": ("V", {"millivolts": 1e-3}),
    "ohm": ("Ω", {"milliohms": 1e-3}),
    "h": ("H", {"millihenries": 1e-3, "microhenries": 1e-6}),
}
"""For the unit at the end of a name: the unit as written, and others in which people have such numbers."""


def _unit_of(name: str) -> str:
    """Return the unit at the end of an option's name, such as "m" or "n_m_s_rad"."""
    parts = name.split("_")
    begin = next((i for i in range(len(parts), 1, -1) if not _UNIT_PART.fullmatch(parts[i - 1])), 1)
    return "_".join(parts[begin:])


def plausible(name: str, turns: int = 1) -> Range:
    """Return the range of an option that gives no bounds: an angle is at most ``turns`` turns, rounded up."""
    return Range(ge=-turns * 6.3, le=turns * 6.3) if _unit_of(name) == "rad" else Range()


def in_another_unit(name: str, value: float, within: Range) -> str:
    """Return a question for a value beyond its range that would be within it in another unit; else an empty text.

    >>> in_another_unit("wheel_radius_m", 76.0, Range(ge=0.001, le=1.0))
    '; 76 m? if you mean millimetres, write 0.076'
    """
    unit, others = _OTHER_UNITS.get(_unit_of(name), ("", {}))
    is_larger = within.le is not None and abs(value) > within.le
    meant = next(((word, value * size) for word, size in others.items() if within.holds(value * size)), None)
    if meant is None or not is_larger:
        return ""
    return f"; {value:.12g} {unit}? if you mean {meant[0]}, write {meant[1]:.5g}"


class Option(NamedTuple):
    """One field of a dataclass of options. ``default`` is MISSING for a required option."""

    name: str
    type: Any
    range: Range
    checks: tuple[Callable[[Any], Any], ...]
    meaning: str
    accepts_others: bool
    given: Expected
    default: Any = MISSING

    @property
    def expected(self) -> str:
        """Which values are valid, for example ``expected a number from 0 to 1``."""
        words = self.given.words
        return f"expected {(words() if callable(words) else words) or _words(self)}"


class Problem(NamedTuple):
    """One wrong, missing or unknown value: the keys that lead to it, and a text on the expected value."""

    path: Path
    kind: Literal["unknown", "missing", "value"]
    words: str
    value: object = ABSENT
    meant: tuple[str, ...] = ()
    """Keys of the same table that may be meant by an unknown one."""

    @property
    def sentence(self) -> str:
        """The problem as one sentence, with the value unless it is a table."""
        key = ".".join(self.path)
        if self.kind == "unknown":
            table = "" if " " in key else key.removesuffix(self.path[-1])  # as in --law dsc, whose gains have no table
            meant = " or ".join(repr(table + one) for one in self.meant)
            return f"unknown key {key}; did you mean {meant}?" if meant else f"unknown key {key}{self.words}"
        if self.kind == "missing":
            return f"{key} is missing; {self.words}"
        if self.value is ABSENT or isinstance(self.value, Mapping) or is_dataclass(self.value):
            return f"{key}: {self.words}"
        return f"{key} = {format_value(self.value)}; {self.words}"


class OptionsError(BadInputError, ValueError):
    """Options are wrong; ``problems`` lists each. If a ``__post_init__`` raises it, paths start at that table."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(problem.sentence for problem in self.problems))


def build(kind: type[T], given: Mapping[str, object], where: str = "") -> T:
    """Make the dataclass ``kind`` from the values of a table; ``where`` is its dotted key, for messages.

    Raises OptionsError, with one line for each problem: unknown names, missing names, wrong types, numbers out of
    range, and errors of the dataclass itself. Missing names are left out if a name is unknown, because that is most
    likely the same mistake.
    """
    if not is_dataclass(kind):
        raise BadInputError(f"{where}: {kind.__qualname__} that holds its defaults must be a dataclass")
    problems: list[Problem] = []
    made = _table(kind, given, tuple(where.split(".")) if where else (), problems)
    if any(problem.kind == "unknown" for problem in problems):
        problems = [problem for problem in problems if problem.kind != "missing"]
    if problems:
        raise OptionsError(problems)
    return made  # type: ignore[no-any-return]


def require_ranges(options: Any, where: str) -> None:
    """Raise OptionsError if an option is wrong; for the ``__post_init__`` of a dataclass made without ``build``."""
    problems: list[Problem] = []
    for name, option in options_of(options.__class__).items():
        _read(option, getattr(options, name), (where, name), problems)
    if problems:
        raise OptionsError(problems)


@functools.cache
def options_of(kind: Any) -> Mapping[str, Option]:
    """Return the options of a dataclass type, by name."""
    hints = get_type_hints(kind, include_extras=True)
    found = {}
    for f in fields(kind):
        if f.init:
            option = _parsed(hints[f.name], f.name)
            if option.range == Range() and kind.__module__.partition(".")[0] == __name__.partition(".")[0]:
                option = option._replace(range=plausible(f.name))  # others say themselves how large theirs may be
            default = f.default if f.default_factory is MISSING else f.default_factory()
            found[f.name] = option._replace(default=default)
    return found


def items(options: Any) -> Iterator[tuple[str, Any]]:
    """Yield name and value of each option of a dataclass instance, as in its table."""
    for name, option in options_of(options.__class__).items():
        value = getattr(options, name)
        yield from value.items() if option.accepts_others else [(name, value)]


def plain(value: Any) -> Any:
    """Convert a dataclass of options, and the dataclasses in it, to dictionaries; return other values unchanged."""
    if isinstance(value, str | float | int):  # most values, and the cheapest question
        return value
    if is_dataclass(value):
        return {name: plain(one) for name, one in items(value)}
    if isinstance(value, Mapping):
        return {name: plain(one) for name, one in value.items()}
    return tuple(map(plain, value)) if isinstance(value, tuple) else value


def format_value(value: object) -> str:
    """Return a value in TOML notation; a value that TOML cannot express in Python's."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(format_value, value))}]"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key} = {format_value(item)}' for key, item in value.items())}}}"
    return str(value)


@functools.cache
def _parsed(annotation: Any, name: str = "") -> Option:
    kind, *extras = get_args(annotation) if get_origin(annotation) is Annotated else (annotation,)
    return Option(
        name,
        kind,
        next((one for one in extras if isinstance(one, Range)), Range()),
        tuple(one for one in extras if callable(one)),
        next((one for one in extras if type(one) is str), ""),
        OTHERS in extras,
        next((one for one in extras if isinstance(one, Expected)), Expected("")),
    )


def _table(kind: type, given: Mapping[str, object], path: Path, problems: list[Problem]) -> Any:
    """Return the dataclass made of a table. Append to ``problems`` and return None if the table is wrong."""
    before, options = len(problems), options_of(kind)
    rest = next((option for option in options.values() if option.accepts_others), None)
    named = {name: value for name, value in given.items() if name in options and options[name] is not rest}
    others = {name: value for name, value in given.items() if name not in named}
    values = {name: _read(options[name], value, (*path, name), problems) for name, value in named.items()}
    if rest is not None:
        values[rest.name] = _read(rest, others, path, problems)
    else:
        known = f"; known: {', '.join(sorted(options))}" if options else "; it takes none"
        problems += [Problem((*path, key), "unknown", known, meant=tuple(near(key, options))) for key in others]
    for name, option in options.items():
        if name not in values and option.default is MISSING:
            problems.append(Problem((*path, name), "missing", option.expected))
    if len(problems) == before:
        try:
            return kind(**values)
        except OptionsError as error:
            problems += [problem._replace(path=path + problem.path) for problem in error.problems]
        except ValueError as error:
            problems.append(Problem(path, "value", str(error)))
    return None


def _read(option: Option, value: Any, path: Path, problems: list[Problem]) -> Any:
    """Return a value, converted and checked for its option. Append to ``problems`` if it is wrong."""
    before = len(problems)
    try:
        value = _typed(option, value, path, problems)
        if len(problems) == before and value is not None:
            for check in option.checks:
                value = check(value)
    except OptionsError as error:
        problems += [problem._replace(path=path + problem.path) for problem in error.problems]
    except ValueError as error:
        problems.append(Problem(path, "value", str(error), value))
    return value


def _typed(option: Option, value: Any, path: Path, problems: list[Problem]) -> Any:
    """Return a value, converted to the option's type. Raises ValueError for a wrong type or a number out of range."""
    kind = option.type
    if kind is float:
        return _float(option, value)
    if kind in (int, bool, str):
        if type(value) is not kind or (kind is int and not option.range.holds(value)):
            raise ValueError(option.expected)
        return value
    origin, inner = get_origin(kind), get_args(kind)
    if type(None) in inner:
        return None if value is None else _read(option._replace(type=inner[0]), value, path, problems)
    if is_dataclass(kind):
        if isinstance(value, Mapping):
            return _table(kind, value, path, problems)  # type: ignore[arg-type]
        if isinstance(value, kind):  # type: ignore[arg-type]
            return value
    elif origin is Literal:
        if any(value == choice and type(value) is type(choice) for choice in inner):
            return value
        if not isinstance(value, str) and str(value) in inner:
            raise ValueError(f"expected text in quotation marks: {format_value(str(value))}")
    elif origin is tuple:
        if isinstance(value, list | tuple) and (inner[-1] is ... or len(value) == len(inner)):
            kinds = [inner[0]] * len(value) if inner[-1] is ... else inner
            pairs = enumerate(zip(kinds, value, strict=True), start=1)
            return tuple(_read(_parsed(one), item, (*path, str(i)), problems) for i, (one, item) in pairs)
    elif origin is not None and issubclass(origin, Mapping):
        if isinstance(value, Mapping):
            return _mapping(inner, value, path, problems)
    else:
        return value
    raise ValueError(option.expected)


def _mapping(kinds: Sequence[Any], value: Mapping[Any, Any], path: Path, problems: list[Problem]) -> dict[Any, Any]:
    key_kind, kind = map(_parsed, kinds)
    read = {}
    for key, one in value.items():
        wrong: list[Problem] = []
        _read(key_kind, key, (*path, str(key)), wrong)
        problems += [problem._replace(value=ABSENT) for problem in wrong]
        read[key] = None if wrong else _read(kind, one, (*path, str(key)), problems)
    return read


def _float(option: Option, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(option.expected)
    try:
        number = float(value)
    except OverflowError:  # a whole number with more than 308 digits
        number = math.inf
    if not math.isfinite(number) and not option.range.infinite:
        raise ValueError(option.expected.replace("a number", "a finite number"))
    if not option.range.holds(number):
        raise ValueError(option.expected + in_another_unit(option.name, number, option.range))
    if math.isfinite(number) and (words := size_words(number)) is not None:
        raise ValueError(f"expected {words}")
    return number


def _words(option: Option) -> str:
    kind, inner = option.type, get_args(option.type)
    origin = get_origin(kind)
    if type(None) in inner:
        return _words(option._replace(type=inner[0]))
    if origin is Literal:
        *first, last = map(format_value, inner)
        return f"{', '.join(first)} or {last}" if first else last
    if origin is tuple:
        if is_dataclass(inner[0]):
            return "an array of tables: write [[...]], with two brackets"
        item = _parsed(inner[0])
        if inner[-1] is not ...:
            return (
                "two numbers: [low, high]" if item.type is float else f"an array of {len(inner)}, each {_words(item)}"
            )
        example = ', as in ["first", "second"]' if item.type is str else ""
        return f"an array, each item {_words(item)}{example}"
    names = {str: "text in quotation marks", bool: "true or false", int: "a whole number", float: "a number"}
    if kind in names:
        return f"{names[kind]}{option.range}"
    return "a table" if is_dataclass(kind) or origin is not None else "a value"
