"""Build hook of the wheel: makes the native parts before the files are gathered."""

import sys
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class CustomBuildHook(BuildHookInterface[Any]):
    """Builds the firmware host library, the plant's FMUs and their shim, with zig where there is no C compiler."""

    def dependencies(self) -> list[str]:
        """Ask for zig on a machine that has to build with it, and only there: it is a large download."""
        sys.path.insert(0, self.root)
        try:
            from tools.build.compiler import ZIG_REQUIREMENT, wants_zig
        finally:
            sys.path.remove(self.root)
        return [ZIG_REQUIREMENT] if wants_zig() else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build, and mark the wheel as one for this platform; the libraries do not depend on the Python version."""
        sys.path.insert(0, self.root)
        try:
            from tools.build import cosim, fmu, wheel_host
        finally:
            sys.path.remove(self.root)
        wheel_host.build()
        fmu.build_all()
        cosim.build()
        build_data["pure_python"] = False
        build_data["infer_tag"] = True
