"""What a run was: the texts that its recording carries, so that a file explains itself."""

import json
import platform
import subprocess
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING

from hil.errors import BadInputError

if TYPE_CHECKING:
    from hil.scenario import Scenario


def properties(scenario: "Scenario") -> dict[str, str]:
    """Return a recording's properties.

    ``scenario`` is a JSON object of every resolved value by its dotted key, ``scenario_sources`` one of where each was
    given, and ``gains`` one of all options of the law, given or left to their defaults; ``scenario_sha256`` is the hash
    that a controller and a device compare. ``fmu_sha256`` is there where the plant's FMU is on this machine, ``commit``
    only when the code runs from a checkout.
    """
    from hil.controllers.registry import gains_in_force
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
        **versions(),
        "gains": json.dumps(gains_in_force(law.law, scenario.directory, law.gains)),
        "scenario_sha256": scenario.hash,
        **_fmu(scenario),
        "scenario": json.dumps({key: value for key, value, _ in values}, default=str),
        "scenario_sources": json.dumps({key: where for key, _, where in values}),
    }


def _fmu(scenario: "Scenario") -> dict[str, str]:
    from hil.plant import archive

    try:
        return {"fmu_sha256": archive.sha256(archive.locate(scenario.plant.fmu, scenario.directory))}
    except BadInputError:
        return {}  # the robot is elsewhere, and needs it there alone


def versions() -> dict[str, str]:
    """Return the versions that a result depends on."""
    found = {
        "mecanum_hil": _version("mecanum-hil"),
        "rerun_sdk": _version("rerun-sdk"),
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
    }
    commit = _commit()
    return found if commit is None else {**found, "commit": commit}


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
        described = subprocess.run(command, capture_output=True, text=True, timeout=5.0, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return described.stdout.strip()
