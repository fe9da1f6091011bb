"""Baselines: NAME.baseline.toml, the figures that the runs of a scenario had when they were last accepted.

It stands beside a user's scenario; of a shipped one in the current folder or, as we ship it, in the package.
"""

import functools
import hashlib
import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from hil.core import TEST_SUFFIX
from hil.core.errors import BadInputError
from hil.core.options import NOT_NEGATIVE, OptionsError, build, format_value, plain
from hil.scenario.toml_text import key_lines, parse
from hil.scenario.values import sha256_of

if TYPE_CHECKING:
    from hil.scenario.scenario import Scenario

SUFFIX = ".baseline.toml"
FORMAT = 2
"""Version of the hash in a baseline."""
_NOT_ASKED = (
    *("plant.", "firmware.", "device.", "realtime.", "service.", "record.", "allow.", "expect."),
    *("link.url", "loop.seed", "loop.mode", "loop.tick_limit_s"),
)
_HEAD = """\
# What runs of {name} had when this was accepted. Made by `hil baseline`; `hil baseline --accept` changes it.
"""


@dataclass(frozen=True)
class Band:
    """A figure in a baseline; all in the figure's unit."""

    value: Annotated[float, "in the run with the scenario's own seed"]
    spread: Annotated[float, NOT_NEGATIVE, "greatest difference between two seeds"]
    band: Annotated[float, NOT_NEGATIVE, "how far from the value a run may be"]


@dataclass(frozen=True)
class Baseline:
    """The content of a baseline.

    ``scenario_sha256`` is that of ``asked``. ``seeds`` are those that made it. ``wire_sha256`` is the hash of all
    frames in lockstep with the first seed; empty in real time, and where the figures alone are judged.
    """

    scenario: str
    scenario_sha256: str
    mode: Literal["lockstep", "realtime"]
    platform: str
    seeds: tuple[int, ...]
    wire_sha256: str
    figure: Mapping[str, Band]
    file: Annotated[str, "where it was read"] = ""


def place(scenario: "Scenario") -> Path:
    """Return where the baseline of a scenario belongs: beside it, of a shipped one in the current folder."""
    folder = Path.cwd() if scenario.path is None else scenario.path.parent
    return folder / f"{scenario.name}{SUFFIX}"


def find(name: str, path: Path | None, directory: Path) -> Baseline | None:
    """Return the baseline of a scenario, or None without one; ``directory`` is that of its file.

    Raises BadInputError for one that cannot be read or is wrong.
    """
    folders = [directory] if path is not None else [Path.cwd(), directory]
    for file in (folder / f"{name}{SUFFIX}" for folder in folders):
        try:
            now = file.stat()
        except OSError:
            continue
        return _read(file, (now.st_mtime_ns, now.st_size))
    return None


def is_baseline(path: str | Path) -> bool:
    """Whether a path is that of a baseline, by its name."""
    return str(path).endswith(SUFFIX)


def without_baselines(names: Sequence[str]) -> list[str]:
    """Return the named scenarios, without the baselines of other named ones.

    A shell's ``suite/*.toml`` names both.
    """

    def scenarios(name: str) -> set[str]:
        stem = name.removesuffix(SUFFIX)
        return {f"{stem}.toml", f"{stem}{TEST_SUFFIX}"}

    return [name for name in names if not (is_baseline(name) and scenarios(name).intersection(names))]


@functools.lru_cache
def _read(file: Path, _version: tuple[int, int]) -> Baseline:
    remedy = "make it anew with `hil baseline --accept`, or take it from version control"
    try:
        text = file.read_text("utf-8")
    except (OSError, ValueError) as error:
        raise BadInputError(f"baseline {file}: it cannot be read ({error}); {remedy}") from error
    lines = key_lines(text)
    try:
        return build(Baseline, {**parse(text, f"baseline {file}"), "file": str(file)})
    except OptionsError as error:
        sentences = (
            f"baseline {file}:{lines.get(problem.path, 1)}: {problem.sentence}; {remedy}" for problem in error.problems
        )
        raise BadInputError("\n".join(sentences)) from None


def text_of(baseline: Baseline) -> str:
    """Return a baseline as TOML: a line for each figure, so that a change is easy to read."""
    head = {name: value for name, value in plain(baseline).items() if name not in ("file", "figure")}
    lines = [f"{name} = {format_value(value)}" for name, value in head.items()]
    figures = [f"{_key(name)} = {format_value(plain(band))}" for name, band in baseline.figure.items()]
    return "\n".join([_HEAD.format(name=baseline.scenario) + lines[0], *lines[1:], "", "[figure]", *figures, ""])


def _key(name: str) -> str:
    return json.dumps(name) if "." in name else name


def asked(scenario: "Scenario") -> dict[str, Any]:
    """Return the demands of a scenario on the system under test, as plain values.

    The other side of the wire is not part of it ([plant], [firmware], [device], the URL of the link), nor is the code
    of the law: a baseline is there to notice their changes. The seed and the judgement of the run are not either. A
    value that equals its key's default is left out. So a baseline stays valid when a key is added or a default changes,
    and judges the effect on the run.
    """
    loop, link, controller = scenario.loop, scenario.link, _unusual(scenario.controller)
    reference = _unusual(scenario.reference)
    if isinstance(file := reference.get("file"), str):
        reference["file"] = sha256_of(scenario.directory / file) or file
    controller["law"] = _last_part(scenario.controller.law)
    controller["shadow"] = []  # of earlier versions: it keeps the hash of baselines
    return {
        "format": FORMAT,
        "limiter": _unusual(scenario.limiter),
        "robot": _unusual(scenario.robot),
        "link": {"command_latency_s": link.command_latency_s, "feedback_latency_s": link.feedback_latency_s},
        "controller": controller,
        "reference": reference,
        "estimator": _unusual(scenario.estimator),
        "loop": {"rate_hz": loop.rate_hz, "duration_s": loop.duration_s, "rearm": loop.rearm},
        "fault": [{name: value for name, value in _unusual(row).items() if name != "name"} for row in scenario.fault],
    }


def _unusual(value: Any) -> Any:
    """Return a dataclass of options as dictionaries without what equals its default, other values as ``plain`` does."""
    if not is_dataclass(value):
        return plain(value)
    usual = {
        one.name: one.default if one.default_factory is MISSING else one.default_factory() for one in fields(value)
    }
    return {name: _unusual(now) for name, before in usual.items() if (now := getattr(value, name)) != before}


def is_asked(key: str) -> bool:
    """Return whether a key of a scenario is part of what it asks."""
    return not key.startswith(_NOT_ASKED)


def asked_sha256(scenario: "Scenario") -> str:
    """Return the SHA-256, in hex, of what a scenario asks."""
    text = json.dumps(_as_floats(asked(scenario)), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode("ascii")).hexdigest()


@functools.cache
def this_platform() -> str:
    """Return what the last bit of a run depends on besides the sources: system, processor, libraries."""
    libc = " ".join(platform.libc_ver()).strip() or "libc of the system"
    python = ".".join(platform.python_version_tuple()[:2])
    return f"{platform.system()} {platform.machine()}, {libc}, Python {python}, NumPy {version('numpy')}"


def _last_part(path: str) -> str:
    return path.replace("\\", "/").rpartition("/")[2]


def _as_floats(value: Any) -> Any:
    """Return whole numbers as floats, so that 9 and 9.0 give the same hash."""
    if isinstance(value, Mapping):
        return {name: _as_floats(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_as_floats(one) for one in value]
    return float(value) if type(value) is int else value
