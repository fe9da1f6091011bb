"""``hil fuzzy``."""

from pathlib import Path
from typing import Annotated

import typer

from hil.cli.options import Force
from hil.core.errors import BadInputError, nearest


def fuzzy(
    tables: Annotated[str, typer.Option(metavar="printed|corrected", help="which of the paper's tables")] = "printed",
    out: Annotated[Path, typer.Option(metavar="FILE.png", help="where the picture goes")] = Path("gains.png"),
    force: Force = False,
) -> None:
    """Draw both gain surfaces of AFDSC's fuzzy block."""
    from hil.cli.gain_picture import draw_gains
    from hil.core.outputs import check_free, existing_files
    from hil.laws.fuzzy import RULES

    if tables not in RULES:
        raise BadInputError(f"--tables {tables}: there are none of this name{nearest(tables, RULES)}")
    if out.suffix.lower() != ".png":
        raise BadInputError(f"--out {out}: a picture is written as PNG; name a file that ends in .png")
    existing = existing_files(force=force)
    check_free("picture", out, existing)
    draw_gains(tables, out, existing)
    print(out)
