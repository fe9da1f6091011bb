"""What a run is known by: a hash of its scenario, of the versions that its figures depend on, and of its seed.

Two runs with one key have the same figures in lockstep, on whatever machine. A path counts by the bytes that are there.
"""

import functools
import hashlib
import json
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from firmware_protocol.built import WHEEL_HOST
from firmware_protocol.generated.messages import SCHEMA_HASH
from hil.core.errors import BadInputError
from hil.laws.registry import law_sha256
from hil.plant import archive
from hil.scenario import Scenario
from hil.scenario.tables import Tables

KEY_FORMAT = 3
"""Counts changes of what the key covers."""
_NOT_OF_THE_RUN = ("service",)
_OPTIONS = (("controller", "gains"), ("controller", "shadow_gains"), ("device", "motors"), ("plant", "start"))
"""What the scenario's tables do not know the types of, beside the options of the reference."""


def key_of(scenario: Scenario) -> str:
    """Return the SHA-256, in hex, of a scenario with its seed and of what it is run with.

    Raises BadInputError when a file that it names cannot be read.
    """
    tables = scenario.model_dump(include=set(Tables.model_fields) - set(_NOT_OF_THE_RUN))
    canonical = {"format": KEY_FORMAT, "versions": versions(), "files": dict(_files(scenario)), "scenario": tables}
    _without_paths(tables)
    tables["reference"] = _as_floats(tables["reference"])
    for table, name in _OPTIONS:
        tables[table][name] = _as_floats(tables[table][name])
    text = json.dumps(canonical, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode("ascii")).hexdigest()


@functools.cache
def versions() -> dict[str, str]:
    """Return the version of this package and of what it says on the wire, and the hash of the firmware's sources."""
    try:
        package = version("mecanum-hil")
    except PackageNotFoundError:
        package = "not installed"
    return {"mecanum_hil": package, "schema": f"{SCHEMA_HASH:08x}", "firmware": str(WHEEL_HOST.digest())}


def _files(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield what names each file of a scenario, and its digest."""
    yield "plant.fmu", _digest(archive.locate(scenario.plant.fmu, scenario.directory))
    # By place and not by name: two files may both have a class Law.
    for place, law in enumerate((scenario.controller.law, *scenario.controller.shadow)):
        if (digest := _law(law, scenario.directory)) is not None:
            yield f"law {place}", digest
    for name, table in (("reference.file", scenario.reference.options), ("device.motors.file", scenario.device.motors)):
        if isinstance(path := table.get("file"), str):
            yield name, _digest(scenario.directory / path)


def _law(law: str, directory: Path) -> str | None:
    """Return the hash of a law's code, None where its source is not there; what it imports is looked at once."""
    file = directory / law.rpartition(":")[0]
    if file.suffix != ".py" or not file.is_file():
        return _law_at(law, directory, 0, 0)
    now = file.stat()
    return _law_at(law, directory, now.st_mtime_ns, now.st_size)


@functools.lru_cache
def _law_at(law: str, directory: Path, _mtime_ns: int, _size: int) -> str | None:
    return law_sha256(law, directory)


def _without_paths(tables: dict[str, Any]) -> None:
    """Leave of each path its last part: where a file is does not change a run."""

    def last(value: object) -> object:
        return value.replace("\\", "/").rpartition("/")[2] if isinstance(value, str) else value

    tables["plant"]["fmu"] = last(tables["plant"]["fmu"])
    controller = tables["controller"]
    controller["law"] = last(controller["law"])
    controller["shadow"] = [last(law) for law in controller["shadow"]]
    for table in (tables["reference"], tables["device"]["motors"]):
        if isinstance(table, dict) and "file" in table:
            table["file"] = last(table["file"])


def _as_floats(value: Any) -> Any:
    """Return whole numbers as the floats that equal them: where an option may be either, 9 and 9.0 are one value."""
    if isinstance(value, dict):
        return {name: _as_floats(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_as_floats(one) for one in value]
    return float(value) if type(value) is int else value


def _digest(path: Path) -> str:
    try:
        now = path.stat()
    except OSError as error:
        raise BadInputError(f"file {path}: it cannot be read ({error.strerror}); a run needs it") from error
    return _digest_of(path, now.st_mtime_ns, now.st_size)


@functools.lru_cache
def _digest_of(path: Path, _mtime_ns: int, _size: int) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
