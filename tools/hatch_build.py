"""Build hook of the wheel: makes the native parts before the files are gathered."""

import sys
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class CustomBuildHook(BuildHookInterface[Any]):
    """Builds the firmware host library, the plant FMU and its shim with this machine's C compiler."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build, and mark the wheel as one for this platform; the libraries do not depend on the Python version."""
        sys.path.insert(0, self.root)
        try:
            import firmware_protocol.build
            import hil.plant.build
            import plant_fmu.build
        finally:
            sys.path.remove(self.root)
        firmware_protocol.build.build()
        plant_fmu.build.build()
        hil.plant.build.build()
        build_data["pure_python"] = False
        build_data["infer_tag"] = True
