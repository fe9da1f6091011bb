"""``hil fuzzy``."""

from pathlib import Path
from typing import Annotated

import typer

from hil.errors import BadInputError, nearest


def fuzzy(
    tables: Annotated[str, typer.Option(metavar="printed|corrected", help="which of the paper's tables")] = "printed",
    out: Annotated[Path, typer.Option(metavar="FILE.png", help="where the picture goes")] = Path("gains.png"),
) -> None:
    """Draw both gain surfaces of AFDSC's fuzzy block."""
    from hil.fuzzy import RULES
    from hil.gain_picture import draw_gains

    if tables not in RULES:
        raise BadInputError(f"--tables {tables}: there are none of this name{nearest(tables, RULES)}")
    if out.suffix.lower() != ".png":
        raise BadInputError(f"--out {out}: a picture is written as PNG; name a file that ends in .png")
    draw_gains(tables, out)
    print(out)
