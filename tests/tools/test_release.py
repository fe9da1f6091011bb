"""The native files of wheels for other machines: compiled with zig, and what the check of a release says of them."""

import os
import zipfile
from pathlib import Path

import pytest

from tools.build.native import WHEEL_TAGS, libraries_for
from tools.elsewhere import differences
from tools.release import faults, newest_changes

# To link for Windows takes a minute, most of it for mingw's own libraries: only make nightly does it.
PLATFORMS = [name for name in WHEEL_TAGS if os.environ.get("HIL_EXAMPLES") == "thorough" or name != "x86_64-windows"]


@pytest.mark.parametrize("platform", PLATFORMS)
def test_the_libraries_of_a_platform_are_its_own_and_of_no_other(platform: str, tmp_path: Path) -> None:
    files = libraries_for(platform, tmp_path / "made")
    assert len(files) == 4, "two libraries, each with its declarations"
    for one, tag in WHEEL_TAGS.items():
        wheel = tmp_path / f"mecanum_hil-0-cp311-abi3-{tag}.whl"
        with zipfile.ZipFile(wheel, "w") as archive:
            for made, place in files.items():
                archive.write(made, place)
        assert (list(faults(wheel, one)) == []) == (one == platform)


def test_the_changes_of_a_release_are_the_newest_section() -> None:
    text = newest_changes()
    assert text.startswith("# ")
    assert "\n## " not in text


def test_figures_elsewhere_may_differ_in_their_last_places_alone() -> None:
    here = {"effort": 8.848486328125, "figures": [1.0, {"law": "afdsc"}], "tick_us": {"p50": 1.0}}
    there = {"effort": 8.848486328124999, "figures": [1.0, {"law": "afdsc"}], "tick_us": {"p50": 9.0}}
    assert list(differences(here, there)) == []
    there["effort"] = 8.8485
    assert list(differences(here, there)) == ["effort is 8.8485, and here 8.848486328125"]
    assert list(differences(here, here | {"figures": [1.0, {"law": "pid"}]})) == [
        "figures.2.law is 'pid', and here 'afdsc'"
    ]
    assert list(differences(here, here | {"figures": []})) != []
