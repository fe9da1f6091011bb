"""The scenario itself: all tables validated and frozen, with its name, place, hash and provenance."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, is_dataclass
from pathlib import Path, PurePath
from typing import Annotated, Any

from hil.core.options import build, items, options_of, plain
from hil.scenario.baseline import Baseline
from hil.scenario.plant import SHIPPED_FMUS
from hil.scenario.tables import Tables
from hil.scenario.values import sha256_of

HASH_FORMAT = 4
"""Version of the hash, so that two versions of this package do not agree by chance."""
_ARRAYS_OF_TABLES = ("fault", "expect")


@dataclass(frozen=True, kw_only=True)
class Scenario(Tables):
    """A run as data. Built by ``hil.scenario.load``, which raises BadInputError for anything that is wrong."""

    name: str
    path: Annotated[Path | None, "its file; None for a shipped one"]
    directory: Annotated[Path, "the folder from which relative paths in it start"]
    provenance: Annotated[Mapping[str, str], "where each dotted key was given, or 'default'"]
    baseline: Annotated[Baseline | None, "what its runs are compared with; None without one"] = None

    @property
    def hash(self) -> str:
        """SHA-256, in hex, of the values on which a controller and a device in two processes must agree.

        That is [robot], [plant], [firmware], loop.rate_hz and loop.seed; of [device] the wheel map and, for third-party
        motor controllers, driver and motors. In which file or order the values were given does not matter. An FMU that
        is not shipped enters by the hash of its bytes, or by its file name where it cannot be read; so does a file of
        [device.motors]. The rest (link, mode, controller, reference, faults, expectations) concerns only one process.
        """
        shared = {
            "format": HASH_FORMAT,
            "robot": plain(self.robot),
            "plant": {
                "fmu": self.fmu_sha256 or PurePath(self.plant.fmu).name,
                "map": plain(self.plant.map),
                "start": self.plant.start,
                "step_s": self.plant.step_s,
            },
            "firmware": plain(self.firmware),
            "device": {"wheels": self.device.wheels, "reversed": sorted(self.device.reversed)} | self._motors(),
            "loop": {"rate_hz": self.loop.rate_hz, "seed": self.loop.seed},
        }
        canonical = json.dumps(shared, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
        return hashlib.sha256(canonical.encode("ascii")).hexdigest()

    def _motors(self) -> dict[str, object]:
        device = self.device
        if not device.is_makers:
            return {}
        motors = dict(items(device.settings))
        if isinstance(motors.get("file"), str):
            motors["file"] = sha256_of(Path(motors["file"])) or PurePath(motors["file"]).name
        return {"driver": device.driver, "motors": motors}

    @property
    def fmu_sha256(self) -> str | None:
        """SHA-256, in hex, of an FMU given by its path; None for a shipped one, and where it cannot be read."""
        return None if self.plant.fmu in SHIPPED_FMUS else sha256_of(self.directory / self.plant.fmu)


def resolved(scenario: Scenario) -> list[tuple[str, object, str]]:
    """Return every value of the scenario as (dotted key, value, where it was given), table by table.

    Keys without a value (an expectation's unused ``above``) are left out.
    """
    return [(key, value, scenario.provenance[key]) for key, value in values(scenario)]


def values(tables: Tables) -> list[tuple[str, object]]:
    """Return dotted key and value of every value except None, in the order of the tables."""
    found: list[tuple[str, object]] = []
    for name in options_of(Tables):
        _walk(getattr(tables, name), name, found)
    return found


def _walk(value: object, key: str, found: list[tuple[str, object]]) -> None:
    if isinstance(value, str | float | int):  # most values, and the cheapest question
        found.append((key, value))
    elif is_dataclass(value) or isinstance(value, Mapping):
        for name, child in value.items() if isinstance(value, Mapping) else items(value):
            _walk(child, f"{key}.{name}", found)
    elif isinstance(value, tuple) and key in _ARRAYS_OF_TABLES:
        for index, row in enumerate(value, start=1):
            _walk(row, f"{key}.{index}", found)
    elif value is not None:
        found.append((key, value))


def tables_of(tables: Tables) -> dict[str, Any]:
    """Return the values of all tables as dictionaries."""
    return {name: plain(getattr(tables, name)) for name in options_of(Tables)}


def to_plain(scenario: Scenario) -> dict[str, Any]:
    """Return a scenario as JSON values, for a process that need not have its files.

    Infinite times stay infinite: Python's ``json`` writes them as ``Infinity``.
    """
    return {
        "tables": tables_of(scenario),
        "name": scenario.name,
        "path": None if scenario.path is None else str(scenario.path),
        "directory": str(scenario.directory),
        "provenance": dict(scenario.provenance),
        "baseline": None if scenario.baseline is None else plain(scenario.baseline),
    }


def from_plain(given: Mapping[str, Any]) -> Scenario:
    """Return the scenario from the values that ``to_plain`` returned."""
    path = None if given["path"] is None else Path(given["path"])
    tables, directory = build(Tables, given["tables"]), Path(given["directory"])
    baseline = None if given["baseline"] is None else build(Baseline, given["baseline"])
    own = {"name": given["name"], "provenance": given["provenance"]}
    return Scenario(**vars(tables), **own, path=path, directory=directory, baseline=baseline)
