"""Build hook of the wheel: makes the native parts before the files are gathered.

By default they are made for this machine. ``HIL_WHEEL_PLATFORM``, one of ``tools.build.native.WHEEL_TAGS``, makes them
for another one with zig.
"""

import os
import sys
import sysconfig
from pathlib import Path
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
        return [ZIG_REQUIREMENT] if wants_zig() or _platform() else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build, and mark the wheel as one for a platform and Pythons from 3.11 on: the module is of the stable ABI."""
        sys.path.insert(0, self.root)
        try:
            from tools.build import native
        finally:
            sys.path.remove(self.root)
        platform = _platform()
        if platform:
            files = native.build_for(platform, Path(self.root, "build", "wheels", platform))
            tag = native.WHEEL_TAGS[platform]
        else:
            files = native.build_here()
            tag = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["pure_python"] = False
        build_data["tag"] = f"cp311-abi3-{tag}"
        if version != "editable":  # there they are in the tree
            build_data["force_include"].update({str(file): place for file, place in files.items()})


def _platform() -> str | None:
    return os.environ.get("HIL_WHEEL_PLATFORM")
