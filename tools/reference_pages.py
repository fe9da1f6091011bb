"""Writes the reference of the documentation site from the code: commands, keys, signals, messages and the rest.

``make docs`` calls it. Nothing that it writes is in the repository.
"""

from collections.abc import Sequence
from dataclasses import MISSING, is_dataclass
from pathlib import Path
from typing import Any, get_args

import typer
from typer.core import TyperGroup
from typer.main import get_group

from firmware_protocol.generate import message_page
from firmware_protocol.schema import read_schema
from hil import references
from hil.cli.commands import by_task
from hil.cli.list import listing
from hil.cli.main import app
from hil.core.options import Option, format_value, options_of
from hil.laws import law_registry as laws
from hil.robot.driver_registry import EXTENSIONS as DRIVERS
from hil.robot.driver_registry import dialect
from hil.scenario.tables import Tables
from plant_fmu import tables, variables
from tools import fault_pages, reproduction_page, rules

DBC = Path(__file__).parents[1] / "firmware_protocol" / "wheel.dbc"
_LISTS = {
    "signals": "What `[[expect]]`, recordings and exports can be about, each tick.",
    "figures": "Figures of a whole run, for `[[expect]]` and baselines.",
    "laws": "`controller.law`. Equations and gains are in [the laws' page](../../hil/laws/LAWS.md).",
    "references": "`reference.kind`. More is in [the references' page](../../hil/references/REFERENCES.md).",
    "links": "`link.url`. What each takes is in [the links' page](../../hil/wire/LINKS.md).",
    "faults": "`[[fault]]`. What all kinds share is in [the faults' page](../../hil/faults/FAULTS.md).",
    "drivers": "`device.driver`. Each maker has a page; see [the drivers' page](../../hil/addons/motors/DRIVERS.md).",
    "scenarios": "What `hil run` and `extends` take by name.",
}
_API = {
    "hil": "Runs and recordings",
    "hil.core.types": "What a law is given, and what it returns",
    "hil.core.ports": "What a package of your own may implement",
    "hil.core.model": "The robot's model",
    "hil.judge.measure": "A figure of your own",
}


def write(folder: Path) -> None:
    """Write all pages of the reference into a folder."""
    folder.mkdir(exist_ok=True)
    pages = {name: _list_page(name, words) for name, words in _LISTS.items()}
    pages["faults"] += fault_pages.sections()
    pages |= {"commands": _commands(), "keys": keys(), "api": _api(), "rules": rules.page()}
    pages |= {"messages": message_page(read_schema(DBC)), "plant": tables.page(variables.read())}
    pages["reproduction"] = reproduction_page.page()
    for name, text in pages.items():
        path = folder / f"{name}.md"
        if not path.exists() or path.read_text(encoding="utf-8") != text:  # Sphinx reads again what is newer
            path.write_text(text, encoding="utf-8")


def _table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    cells = ([str(cell).replace("|", "\\|").replace("\n", " ") for cell in line] for line in lines)
    return "".join(f"| {' | '.join(line)} |\n" for line in cells)


def _list_page(name: str, words: str) -> str:
    header, rows = listing(name)
    marked = [(f"`{first}`", *others) for first, *others in rows]
    return f"# {name.capitalize()}\n\n{words}\n\n{_table(header, marked)}"


def _commands() -> str:
    """Return the help of every command, as it is printed."""
    text = "# Commands\n\nThe help of every command, as `hil COMMAND -h` prints it.\n"
    program = get_group(app)
    context = typer.Context(program, info_name="hil", terminal_width=100)
    for group, names in by_task().items():
        text += f"\n## {group}\n" + "".join(_help(program, name, context) for name in names)
    return text


def _help(group: TyperGroup, name: str, above: typer.Context) -> str:
    """Return the help of a command and of its subcommands."""
    command: Any = group.get_command(above, name)
    context = typer.Context(command, parent=above, info_name=name)
    text = f"\n### {context.command_path}\n\n```text\n{command.get_help(context)}\n```\n"
    below = command.list_commands(context) if isinstance(command, TyperGroup) else ()
    return text + "".join(_help(command, one, context) for one in below)


def keys() -> str:
    """Return every key of a scenario with its default, its allowed values and its meaning."""
    text = (
        "# Keys of a scenario\n\nA key without a default has to be given, by the file or by the scenario it extends.\n"
    )
    for name, option in options_of(Tables).items():
        text += _section(name, option)
    text += "\n## Gains of each law\n\nIn `[controller.gains]`.\n"
    text += "".join(_options(getattr(law, "Options"), f"### {name}", "") for name, law in laws.shipped_laws().items())  # noqa: B009
    text += "\n## Keys of each reference\n\nIn `[reference]`, beside `kind`.\n"
    text += "".join(_options(kind, f"### {name}", "") for name, kind in references.shipped_references().items())
    text += "\n## Settings of each maker's driver\n\nIn `[device.motors]`.\n"
    text += "".join(_options(dialect(name).settings, f"### {name}", "") for name in DRIVERS.ours)
    return text


def _section(name: str, option: Option) -> str:
    kind = option.type
    inner = next((one for one in (kind, *get_args(kind)) if is_dataclass(one)), None)
    if inner is None:
        return ""
    title = f"[[{name}]]" if kind is not inner and get_args(kind)[-1] is ... else f"[{name}]"
    return _options(inner, f"## `{title}`", name)


def _options(kind: Any, heading: str, name: str) -> str:
    """Return the options of a dataclass as a table below a heading, and the tables in it after that."""
    rows, below = [], ""
    for key, each in options_of(kind).items():
        nested = _section(f"{name}.{key}", each)
        if nested:
            below += nested
        elif not each.accepts_others:
            default = "" if each.default in (MISSING, None) else f"`{format_value(each.default)}`"
            rows.append((f"`{key}`", default, each.expected.removeprefix("expected "), each.meaning))
    return f"\n{heading}\n\n{_table(('key', 'default', 'value', 'meaning'), rows)}{below}"


def _api() -> str:
    return "# Python\n" + "".join(
        f"\n## {title}\n\n```{{eval-rst}}\n.. automodule:: {module}\n   :members:\n```\n"
        for module, title in _API.items()
    )
