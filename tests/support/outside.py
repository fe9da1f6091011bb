"""Another package, installed for one test: a distribution with entry points, as pip leaves it on the path."""

import sys
from collections.abc import Mapping
from pathlib import Path
from textwrap import dedent

import pytest


def outside_package(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    module_source: str,
    groups: Mapping[str, Mapping[str, str]],
    package: str = "outside-package",
    module: str | None = None,
) -> Path:
    """Install a package of one module and return its folder, which subprocesses can have in PYTHONPATH.

    ``groups`` are its entry points: ``{"hil.references": {"my_path": "outside_package:MyPath"}}``. The module is
    named like the package, with underscores, unless ``module`` names it. ``module_source`` may be indented.
    """
    folder = tmp_path / package
    name = package.replace("-", "_")
    metadata = folder / f"{name}-1.0.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    sections = [
        f"[{group}]\n" + "".join(f"{point} = {value}\n" for point, value in points.items())
        for group, points in groups.items()
    ]
    (metadata / "entry_points.txt").write_text("\n".join(sections))
    (folder / f"{module or name}.py").write_text(dedent(module_source))
    monkeypatch.syspath_prepend(folder)
    monkeypatch.delitem(sys.modules, module or name, raising=False)
    return folder
