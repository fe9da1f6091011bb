"""The properties of a recording: they identify the run and what it was made from."""

import hashlib
import json
import os
import platform
import subprocess
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING

from hil.core.errors import BadInputError
from hil.core.options import plain

if TYPE_CHECKING:
    from hil.scenario import Scenario


def ingredients(scenario: "Scenario") -> dict[str, str]:
    """Return what decides a run besides its scenario's text: the law's options, and SHA-256 hashes of files and code.

    Call it when the parts of the run are made: files may change before a recording begins. Adds to ``law_ingredients``:
    ``commit`` if the code runs from a checkout; ``map_sha256`` of ``[plant.map]``; ``reference_file_sha256`` and
    ``motors_file_sha256`` of files that the scenario names. The code of another package's reference and driver gives
    ``reference_sha256`` and ``driver_sha256``, an FMU on this machine ``fmu_sha256``. The native libraries that this
    process has loaded give ``wheel_host_sha256`` and ``cosim_sha256``. Their sources, the same on every machine, give
    ``wheel_host_sources_sha256`` and ``cosim_sources_sha256``. A key without a value is left out.

    Raises BadInputError as ``law_ingredients``, and for an FMU or a native library that cannot be used.
    """
    with ThreadPoolExecutor(1) as pool:
        commit = pool.submit(_commit)  # git takes as long as all the hashes
        found = law_ingredients(scenario) | _hashes(scenario) | {"commit": commit.result()}
    return {name: text for name, text in found.items() if text is not None}


def _hashes(scenario: "Scenario") -> dict[str, str | None]:
    from hil.laws.code import code_of_module
    from hil.references import reference_module
    from hil.robot.driver_registry import driver_module

    directory = scenario.directory
    files = {"reference_file": scenario.reference.options, "motors_file": scenario.device.motors}
    return {
        "map_sha256": hashlib.sha256(json.dumps(plain(scenario.plant.map), sort_keys=True).encode()).hexdigest(),
        **{f"{name}_sha256": _sha256_of(table.get("file"), directory) for name, table in files.items()},
        "reference_sha256": code_of_module(reference_module(scenario.reference.kind)),
        "driver_sha256": code_of_module(driver_module(scenario.device.driver)),
        **_plant_and_libraries(scenario),
    }


def law_ingredients(scenario: "Scenario") -> dict[str, str]:
    """Return the part of ``ingredients`` that concerns the law.

    ``gains``: a JSON object of all options of the law, including defaults. ``law_sha256``: hash of the law's code
    (``hil.laws.code``). Raises BadInputError as ``gains_in_force``.
    """
    from hil.laws.law_registry import gains_in_force, law_sha256

    law, directory = scenario.controller, scenario.directory
    found = {"gains": json.dumps(gains_in_force(law.law, directory, law.gains))}
    if (code := law_sha256(law.law, directory)) is not None:
        found["law_sha256"] = code
    return found


def properties(scenario: "Scenario", made_of: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return a recording's properties. ``made_of`` are its ``ingredients``; by default they are computed now.

    ``scenario`` is a JSON object of every resolved value by its dotted key, ``scenario_sources`` one of their sources.
    ``scenario_sha256`` is the hash that a controller and a device compare.
    """
    from hil.scenario import resolved

    values = resolved(scenario)
    law = scenario.controller
    return {
        "scenario_name": scenario.name,
        "law": law.law,
        "command": law.command,
        "mode": scenario.loop.mode,
        "link": scenario.link.url,
        "seed": str(scenario.loop.seed),
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        **_packages(),
        **(ingredients(scenario) if made_of is None else made_of),
        "scenario_sha256": scenario.hash,
        "scenario": json.dumps({key: value for key, value, _ in values}, default=str),
        "scenario_sources": json.dumps({key: where for key, _, where in values}),
    }


def _plant_and_libraries(scenario: "Scenario") -> dict[str, str | None]:
    from firmware_protocol import extension
    from firmware_protocol.built import BuildError
    from hil.plant import archive, shim
    from hil.wire.url import parse_link

    has_robot = parse_link(scenario.link.url).is_within_process
    found: dict[str, str | None] = {}
    if has_robot or not scenario.device.is_makers:
        try:
            found["wheel_host_sha256"] = extension.loaded().sha256
        except BuildError as error:
            raise BadInputError(str(error)) from error
        found["wheel_host_sources_sha256"] = extension.loaded().sources_sha256
    if has_robot:
        found["fmu_sha256"] = archive.sha256(archive.locate(scenario.plant.fmu, scenario.directory))
        found |= {"cosim_sha256": shim.loaded().sha256, "cosim_sources_sha256": shim.loaded().sources_sha256}
    elif (fmu := archive.place(scenario.plant.fmu, scenario.directory)).is_file():
        found["fmu_sha256"] = archive.sha256(fmu)  # the robot runs elsewhere; only there the FMU is required
    return found


def _sha256_of(file: object, directory: Path) -> str | None:
    """Return the hash of the file that an option names; None if it names none or the file cannot be read."""
    try:
        return hashlib.sha256((directory / file).read_bytes()).hexdigest() if isinstance(file, str) else None
    except OSError:
        return None


def versions() -> dict[str, str]:
    """Return the versions that a result depends on."""
    commit = _commit()
    return _packages() if commit is None else {**_packages(), "commit": commit}


def _packages() -> dict[str, str]:
    return {
        "mecanum_hil": _version("mecanum-hil"),
        "rerun_sdk": _version("rerun-sdk"),
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _commit() -> str | None:
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return None
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
    try:
        # Without its lock: git refreshes the index else, and one that is killed, as by a limit, leaves the lock there.
        unlocked = os.environ | {"GIT_OPTIONAL_LOCKS": "0"}
        described = subprocess.run(command, capture_output=True, text=True, timeout=5.0, check=True, env=unlocked)
    except (OSError, subprocess.SubprocessError):
        return None
    return described.stdout.strip()
