"""Build targets of the plant: the C shim between the firmware's plant port and an FMU, and the shipped FMUs."""

from pathlib import Path

import plant_fmu.mujoco
from firmware_protocol.built import ROOT, SUFFIX, Built, digest_in_library
from plant_fmu.sources import HERE as PLANTS
from plant_fmu.sources import INPUTS, sources_of

HERE = Path(__file__).parent
PLANT_PORT = ROOT / "firmware_protocol" / "firmware" / "plant_port.h"
HEADERS = (PLANT_PORT, *(HERE / f"{name}.h" for name in ("cosim", "derive", "remote", "robot_faults", "windows")))
SOURCES = tuple(HERE / f"{name}.c" for name in ("cosim", "callbacks", "derive", "remote", "robot_faults", "windows"))
INCLUDE = (HERE, PLANT_PORT.parent)
COSIM = Built(HERE / f"libcosim{SUFFIX}", "tools.build.cosim", (*SOURCES, *HEADERS), digest_in_library)
MUJOCO = plant_fmu.mujoco.path()
_SCRIPTS = dict.fromkeys(INPUTS, "tools.build.fmu") | {MUJOCO: "tools.build.mujoco_fmu"}
FMUS = {path: Built(path, _SCRIPTS[path], inputs, sources_of, PLANTS.parent) for path, inputs in INPUTS.items()}
"""The FMUs of this package, by path."""
