"""Generates the tables of variables: documentation/index.html of the FMU, and a page of docs/reference."""

import html

from plant_fmu.variables import HERE, Definition, DefinitionError, Variable

DOCUMENT = "documentation/index.html"
_BEGIN, _END = "<!-- variables: begin -->", "<!-- variables: end -->"
_HEADS = ("variable", "causality", "unit", "start", "range", "meaning")


def document(definition: Definition) -> str:
    """Return documentation/index.html with its table renewed. Raises DefinitionError when it lacks the marks."""
    text = (HERE / DOCUMENT).read_text(encoding="utf-8")
    if _BEGIN not in text or _END not in text:
        raise DefinitionError(f"{DOCUMENT}: the marks {_BEGIN} and {_END} are missing")
    head, rest = text.split(_BEGIN, 1)
    return f"{head}{_BEGIN}\n{html_tables(definition)}\n{_END}{rest.split(_END, 1)[1]}"


def page(definition: Definition) -> str:
    """Return the page of docs/reference with all variables."""
    lines = ["# Variables of the plant", "", "In SI units. `*` stands for each wheel: `fl`, `fr`, `rr`, `rl`.", ""]
    lines += ["| " + " | ".join(_HEADS) + " |", "|" + "---|" * len(_HEADS)]
    lines += ["| " + " | ".join([f"`{row[0]}`", *row[1:]]) + " |" for row in _rows(definition)]
    return "\n".join(lines) + "\n"


def html_tables(definition: Definition) -> str:
    """Return the tables of inputs, outputs and parameters for an FMU's page."""
    rows = _rows(definition)
    lines = []
    for title, causality in (("Inputs", "input"), ("Outputs", "output"), ("Parameters", "parameter")):
        lines += [f'<h3 id="{title.lower()}">{title}</h3>', "<table>"]
        lines.append("<tr>" + "".join(f"<th>{head}</th>" for head in _HEADS) + "</tr>")
        lines += [_html_row(row) for row in rows if causality in row[1]]
        lines.append("</table>")
    return "\n".join(lines)


def _html_row(row: tuple[str, ...]) -> str:
    name, *cells = (html.escape(cell) for cell in row)
    return f"<tr><td><code>{name}</code></td>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"


def _rows(definition: Definition) -> list[tuple[str, ...]]:
    return [_row(definition, variable) for variable in definition.variables if not variable.wheel]


def _row(definition: Definition, variable: Variable) -> tuple[str, ...]:
    name, meaning = variable.name, variable.description
    if variable.wheel is not None:
        wheel, words = list(definition.wheels.items())[variable.wheel]
        name, meaning = name.replace(f".{wheel}.", ".*."), meaning.replace(f"{words} ", "")
    limits = "" if variable.minimum is None else f"{variable.minimum:.8g} to {variable.maximum:.8g}"
    start = "" if variable.start is None else f"{variable.start:.8g}"
    if variable.type == "Enumeration":
        items = [f"{item['name']} ({value})" for value, item in enumerate(_items(definition, variable), start=1)]
        limits, start = ", ".join(items), str(_items(definition, variable)[int(variable.start or 1) - 1]["name"])
    causality = "tunable parameter" if variable.variability == "tunable" else variable.causality
    return (name, causality, variable.unit or "", start, limits, meaning)


def _items(definition: Definition, variable: Variable) -> list[dict[str, str]]:
    items: list[dict[str, str]] = definition.enumerations[variable.name]["items"]
    return items
