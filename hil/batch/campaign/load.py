"""Loads a campaign: its file, checked, and its scenario."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from hil.batch.campaign.tables import PlanTables
from hil.batch.plan_file import PlanFile, read_plan_file
from hil.core.errors import BadInputError
from hil.scenario import Scenario, Sources, read
from hil.scenario.load import with_baseline
from hil.scenario.values import is_path

_OTHER_SIDE = ("plant.", "firmware.", "device.")


class Plan(NamedTuple):
    """A campaign that was loaded: its file, the tables there, and the files of its scenario."""

    file: PlanFile
    tables: PlanTables
    sources: Sources

    def scenario(self, sets: Mapping[str, object]) -> Scenario:
        """Return the scenario with these values. Raises BadInputError, which names the campaign's file and line.

        It has its baseline, unless the values are such as no baseline is made for: of the system on the other side of
        the wire.
        """
        tables = dict.fromkeys(self.tables.set, "set") | dict.fromkeys(self.tables.axes, "axes")
        scenario = self.file.scenario(self.sources, sets, tables)
        return scenario if any(key.startswith(_OTHER_SIDE) for key in sets) else with_baseline(scenario)


def load_plan(path: Path) -> Plan:
    """Return the campaign of a file. Raises BadInputError, with one line for each problem."""
    file = read_plan_file(path, "campaign")
    laws = file.document.get("laws")
    if isinstance(laws, tuple):  # a law may be given by its name alone
        laws = tuple({"law": one} if isinstance(one, str) else one for one in laws)
        file = file._replace(document={**file.document, "laws": laws})
    tables = file.tables(PlanTables)
    name = tables.scenario
    try:
        sources = read(file.folder / name if is_path(name) else name)
    except BadInputError as error:
        raise BadInputError(f"campaign {file.place('scenario')}: {error}") from error
    return Plan(file, tables, sources)
