"""Small FMUs for FMI 2.0 and FMI 3.0, whole or broken in one way, compiled from tests/fmus_broken."""

import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy

from hil.plant import archive
from plant_fmu.build import compile_shared

HERE = Path(__file__).with_name("fmus_broken")
HEADERS = Path(fmpy.__file__).with_name("c-code")  # the standard's own
Change = Callable[[str, bytes], bytes | None]


def lag(folder: Path, fmi: int, fault: str = "NO_FAULT", change: Change = lambda _, data: data) -> Path:
    """Build the FMU with a fault of lag.h, its members changed or, for None, left out."""
    library = folder / f"lag_{fmi}_{fault}{archive.LIBRARY_SUFFIX}"
    if not library.exists():
        sources = (HERE / "lag.c", HERE / f"lag_fmi{fmi}.c")
        compile_shared(sources, library, include=(HERE, HEADERS), flags=(f"-DBREAK={fault}",))
    name = f"binaries/{archive.binary_folders(f'{fmi}.0')[-1]}/lag{archive.LIBRARY_SUFFIX}"
    members = {"modelDescription.xml": HERE / f"lag_fmi{fmi}.xml", name: library}
    fmu = folder / f"lag_fmi{fmi}.fmu"
    with zipfile.ZipFile(fmu, "w") as packed:
        for member, path in members.items():
            if (data := change(member, path.read_bytes())) is not None:
                packed.writestr(member, data)
    return fmu
