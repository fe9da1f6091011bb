"""What pages say of options: the tables of names and defaults, read without the code that they describe."""

import contextlib
import re
import tomllib


def sections(page: str) -> dict[str, str]:
    """Return the sections of a page by their headings of the second level."""
    return {part.partition("\n")[0]: part for part in page.split("\n## ")[1:]}


def defaults(section: str) -> dict[str, object]:
    """Return the defaults of options in the tables of a section; rows that give none are left out.

    The first cell names options in backticks, the second has the default of each, as in TOML.
    """
    found: dict[str, object] = {}
    for names, cell in re.findall(r"^\| (`[^|]*`) \| ([^|]+) \|", section, re.MULTILINE):
        with contextlib.suppress(tomllib.TOMLDecodeError):
            values = tomllib.loads(f"values = [{cell.replace('`', '')}]")["values"]
            found |= dict(zip(re.findall(r"`(\w+)`", names), values, strict=True)) if values else {}
    return found
