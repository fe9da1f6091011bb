"""Makes the ROS 2 package from its sources in tools/ros2/, for a workspace of colcon.

``python -m tools.build.ros_package`` writes ``dist/ros/mecanum_hil_ros`` with the version and license of this tree.
"""

import argparse
import re
import shutil
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
NAME = "mecanum_hil_ros"
SOURCES = ROOT / "tools" / "ros2" / NAME
OUT = ROOT / "dist" / "ros"


def build(out: Path = OUT) -> Path:
    """Write the package into a folder, in the place of an older one, and return its path."""
    package = out / NAME
    shutil.rmtree(package, ignore_errors=True)
    shutil.copytree(SOURCES, package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "LICENSE", package)
    version = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["version"]
    manifest = package / "package.xml"
    text, count = re.subn(r"<version>.*</version>", f"<version>{version}</version>", manifest.read_text("utf-8"))
    assert count == 1, f"{manifest} has {count} versions"
    manifest.write_text(text, encoding="utf-8")
    return package


def main() -> None:
    """Make the package and print where it is."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=OUT, help="folder for it")
    print(build(parser.parse_args().out))


if __name__ == "__main__":
    main()
