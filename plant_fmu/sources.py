"""The sources that decide how each of this project's FMUs runs, and the hash of them that an FMU holds.

Every process with a plant imports this module, so it imports nothing that only building needs. Documents and reference
results in the FMU change no run and are left out.
"""

import zipfile
from pathlib import Path

import plant_fmu
from plant_fmu import mujoco
from plant_fmu.mujoco.definition import PARTS

HERE = Path(__file__).parent
GENERATED = HERE / "generated"
DEFINITION = HERE / "variables.toml"
SOURCE_FILES = (
    "fmi2.c",
    "fmi2_unclaimed.c",
    "fmi3.c",
    "fmi3_unclaimed.c",
    "instance.c",
    "saved_state.c",
    "mecanum.c",
    "mecanum_physics.c",
    "model.c",
    "motor.c",
    "contact.c",
    "friction.c",
    "sensors.c",
    "tip.c",
)
SOURCES = tuple(HERE / name for name in SOURCE_FILES)
HEADERS = (*sorted(HERE.glob("*.h")), *sorted(GENERATED.glob("*.h")))
# Members of each version's archive besides the common ones: member -> file.
DESCRIPTIONS = {
    2: {"modelDescription.xml": GENERATED / "fmi2" / "modelDescription.xml"},
    3: {
        "modelDescription.xml": GENERATED / "fmi3" / "modelDescription.xml",
        "terminalsAndIcons/terminalsAndIcons.xml": GENERATED / "fmi3" / "terminalsAndIcons.xml",
    },
}


def comment_of(archive: Path) -> str | None:
    """Return the comment of an archive; None if the file is no archive."""
    if not zipfile.is_zipfile(archive):
        return None
    with zipfile.ZipFile(archive) as opened:
        return opened.comment.decode("ascii", "replace")


def sources_of(archive: Path) -> str | None:
    """Return the hash of the sources from which an FMU was built; None if its comment holds none.

    The comment has two hashes: of everything that the archive was made from, including the compiler, and of the sources
    alone.
    """
    words = (comment_of(archive) or "").split()
    return words[1] if len(words) == 2 else None


MUJOCO = HERE / "mujoco"
MUJOCO_SOURCES = (
    *(HERE / name for name in ("fmi2.c", "fmi2_unclaimed.c", "instance.c", "saved_state.c", "sensors.c")),
    MUJOCO / "physics.c",
    MUJOCO / "robot.c",
)
MUJOCO_HEADERS = (*sorted(HERE.glob("*.h")), MUJOCO / "robot.h", MUJOCO / "state.h")
INPUTS = {
    **{plant_fmu.path(fmi): (*SOURCES, *HEADERS, DEFINITION, *files.values()) for fmi, files in DESCRIPTIONS.items()},
    mujoco.path(): (*MUJOCO_SOURCES, *MUJOCO_HEADERS, *PARTS),
}
"""The sources of each FMU, by the FMU's path."""
