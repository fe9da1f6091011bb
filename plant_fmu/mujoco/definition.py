"""The variables of the MuJoCo plant, read from variables.toml here and in the folder above.

Needs the standard library only.
"""

import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from plant_fmu import variables

HERE = Path(__file__).parent
PARTS = (variables.HERE / "variables.toml", HERE / "variables.toml")


def read() -> variables.Definition:
    """Return the variables. Raises DefinitionError with the name of one that is not in ../variables.toml."""
    whole, own = (tomllib.loads(path.read_text(encoding="utf-8")) for path in PARTS)
    entries = {entry["name"]: entry for entry in whole["variable"]}
    model: dict[str, Any] = own["model"]
    taken = model.pop("take")
    if unknown := {*taken, *own["change"]} - set(entries):
        raise variables.DefinitionError(f"mujoco/variables.toml: {min(unknown)!r} is not in ../variables.toml")
    chosen = [{**entries[name], **own["change"].get(name, {})} for name in taken]
    names = {name.replace("*", wheel) for name in taken for wheel in whole["wheels"]} | {variables.TIME}
    for entry in chosen:
        if "depends_on" in entry:
            entry["depends_on"] = [name for name in entry["depends_on"] if names & _expanded(name, whole["wheels"])]
    units = {entry["unit"] for entry in chosen if "unit" in entry}
    return variables.define(
        {
            "model": model,
            "wheels": whole["wheels"],
            "units": {name: exponents for name, exponents in whole["units"].items() if name in units},
            "display_units": {name: shown for name, shown in whole["display_units"].items() if name in units},
            "enumerations": {name: items for name, items in whole["enumerations"].items() if name in taken},
            "variable": chosen,
        }
    )


def _expanded(name: str, wheels: Iterable[str]) -> set[str]:
    return {name.replace("*", wheel) for wheel in wheels}
