"""Generates mecanum_variables.h: C structures of the plant's variables, and their table by value reference."""

import math

from plant_fmu.variables import STRUCTURE, Definition, Variable

_C_TYPE = {"Real": "REAL", "Integer": "INTEGER", "Enumeration": "ENUMERATION"}
_INT32 = (-(2**31), 2**31 - 1)
_HEADER = """\
/* Made from variables.toml by generate.py; do not edit. */
#ifndef MECANUM_VARIABLES_H
#define MECANUM_VARIABLES_H

#include <math.h>
#include <stdint.h>

#define MECANUM_MODEL_NAME "{name}"
#define MECANUM_GUID "{guid}"
#define MECANUM_WHEELS {wheels}
#define MECANUM_VARIABLE_COUNT {count}

enum {{
{items}
}};

{structures}
/* X(value reference, type, causality, member of the snapshot, start, min, max, name) */
/* clang-format off */
#define MECANUM_VARIABLES(X) \\
{rows}
/* clang-format on */

#endif
"""


def c_header(definition: Definition, guid: str) -> str:
    """Return mecanum_variables.h; ``guid`` is the one that an importer must give to get an instance."""
    items = [
        f"    MECANUM_{name.upper()}_{item['name'].upper()} = {value},"
        for name, enumeration in definition.enumerations.items()
        for value, item in enumerate(enumeration["items"], start=1)
    ]
    structures = []
    for causality, structure in STRUCTURE.items():
        structures.append("typedef struct {")
        for variable in definition.variables:
            if variable.causality == causality and not variable.wheel:
                kind = "double" if variable.type == "Real" else "int32_t"
                size = "" if variable.wheel is None else "[MECANUM_WHEELS]"
                structures.append(f"    {kind} {variable.field}{size};")
        structures += [f"}} mecanum_{structure};", ""]
    rows = [f"    X({reference}, {_c_row(v)})" for reference, v in enumerate(definition.variables)]
    return _HEADER.format(
        name=definition.model["name"],
        guid=guid,
        wheels=len(definition.wheels),
        count=len(definition.variables),
        items="\n".join(items),
        structures="\n".join(structures),
        rows=" \\\n".join(rows),
    )


def _c_row(v: Variable) -> str:
    numbers = f"{_c_number(v, v.start, 0)}, {_c_number(v, v.minimum, -1)}, {_c_number(v, v.maximum, 1)}"
    causality = "TUNABLE" if v.variability == "tunable" else v.causality.upper()
    return f'{_C_TYPE[v.type]}, {causality}, {v.member}, {numbers}, "{v.name}"'


def _c_number(variable: Variable, value: float | int | None, side: int) -> str:
    """Return a limit or a start value as a C double. Without one: the type's own limit on that ``side``, or 0."""
    if value is None and side and variable.type == "Real":
        value = side * math.inf
    elif value is None:
        value = _INT32[0] if side < 0 else _INT32[1] if side > 0 else 0
    if math.isinf(value):
        return "-INFINITY" if value < 0 else "INFINITY"
    return repr(float(value))
