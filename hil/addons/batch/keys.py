"""The key of a job: a hash of its scenario with its seed, of the files it names, and of the versions it depends on.

Two jobs with the same key have the same figures in lockstep, on any machine. A file enters by its bytes, not its path.
"""

import functools
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from firmware_protocol.built import WHEEL_HOST
from firmware_protocol.generated.messages import SCHEMA_HASH
from hil.addons.batch.job import Job
from hil.core.errors import BadInputError
from hil.core.options import plain
from hil.laws.code import code_of_module
from hil.laws.law_registry import law_file, law_sha256
from hil.plant import archive
from hil.references import reference_module
from hil.robot.driver_registry import driver_module
from hil.scenario import Scenario, to_plain
from hil.scenario.scenario import tables_of

KEY_FORMAT = 3
"""Version of the key: raised when the key covers something else."""
SCENARIO_RUN = "hil.addons.batch.run:run"
"""The usual kind of job: run the scenario and return all its figures."""
_NOT_OF_THE_RUN = ("service",)
_OPTIONS = (("controller", "gains"), ("device", "motors"), ("plant", "start"))
"""Tables of the scenario whose values have no declared type, like the options of the reference."""


def make_job(
    scenario: Scenario,
    kind: str = SCENARIO_RUN,
    options: Mapping[str, Any] | None = None,
    *,
    signals: Sequence[str] = (),
    scratch: Path | None = None,
    **how: Any,
) -> Job:
    """Return the job of a scenario, with its key; ``how`` are those fields of Job that the key does not cover.

    With a folder ``scratch`` the job leaves these signals there, for ``saved_signals``. Raises BadInputError when a
    file that the scenario names cannot be read.
    """
    options = dict(options or {})
    if scratch is not None:
        options["signals"] = list(signals)
    key = key_of(scenario, kind, options)
    if scratch is not None:
        how["signals_file"] = str(scratch / f"{key}.npz")
    return Job(key, kind, to_plain(scenario), options, **how)


def key_of(scenario: Scenario, kind: str = SCENARIO_RUN, options: Mapping[str, Any] | None = None) -> str:
    """Return the SHA-256, in hex, of all that decides the outcome of a job.

    Raises BadInputError when a file that the scenario names cannot be read.
    """
    tables = {name: table for name, table in tables_of(scenario).items() if name not in _NOT_OF_THE_RUN}
    canonical = {"format": KEY_FORMAT, "versions": versions(), "files": _files(scenario), "scenario": tables}
    _without_paths(tables)
    tables["reference"] = _as_floats(tables["reference"])
    for table, name in _OPTIONS:
        tables[table][name] = _as_floats(tables[table][name])
    if scenario.baseline is not None:
        canonical["baseline"] = plain(replace(scenario.baseline, file=""))
    if kind != SCENARIO_RUN or options:
        canonical |= {"kind": kind, "options": options}
    text = json.dumps(canonical, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode("ascii")).hexdigest()


@functools.cache
def versions() -> dict[str, str]:
    """Return the version of this package and of the wire protocol, and the hash of the firmware's sources."""
    try:
        package = version("mecanum-hil")
    except PackageNotFoundError:
        package = "not installed"
    return {"mecanum_hil": package, "schema": f"{SCHEMA_HASH:08x}", "firmware": str(WHEEL_HOST.digest())}


def _files(scenario: Scenario) -> dict[str, str]:
    directory = scenario.directory
    named = {"reference.file": scenario.reference.options, "device.motors.file": scenario.device.motors}
    found = {
        "plant.fmu": _digest(archive.locate(scenario.plant.fmu, directory)),
        "law": _law(scenario.controller.law, directory),
        "reference.kind": code_of_module(reference_module(scenario.reference.kind)),
        "device.driver": code_of_module(driver_module(scenario.device.driver)),
        **{
            key: _digest(directory / file) for key, table in named.items() if isinstance(file := table.get("file"), str)
        },
    }
    return {name: digest for name, digest in found.items() if digest is not None}


def _law(law: str, directory: Path) -> str | None:
    """Return the hash of a law's code, None without its source; cached until the law's own file changes."""
    file = law_file(law)
    now = (directory / file).stat() if file and (directory / file).is_file() else None
    return _law_at(law, directory, now and (now.st_mtime_ns, now.st_size))


@functools.lru_cache
def _law_at(law: str, directory: Path, _version: tuple[int, int] | None) -> str | None:
    return law_sha256(law, directory)


def _without_paths(tables: dict[str, Any]) -> None:
    """Reduce each path to its last part: the folder of a file does not change a run."""

    def last(value: object) -> object:
        return value.replace("\\", "/").rpartition("/")[2] if isinstance(value, str) else value

    files = ((tables["reference"], "file"), (tables["device"]["motors"], "file"))
    for table, key in ((tables["plant"], "fmu"), (tables["controller"], "law"), *files):
        if isinstance(table, dict) and key in table:
            table[key] = last(table[key])


def _as_floats(value: Any) -> Any:
    """Return whole numbers as floats, so that 9 and 9.0 give the same key where an option may be either."""
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
    return _digest_of(path, (now.st_mtime_ns, now.st_size))


@functools.lru_cache
def _digest_of(path: Path, _version: tuple[int, int]) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
