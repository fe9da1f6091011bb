"""The native files of wheels for other machines: compiled with zig, and what the check of a release says of them."""

import zipfile
from pathlib import Path

import pytest

from tools.build.native import WHEEL_TAGS, libraries_for
from tools.release import faults, newest_changes


@pytest.mark.parametrize("platform", WHEEL_TAGS)
def test_the_libraries_of_a_platform_are_its_own_and_of_no_other(platform: str, tmp_path: Path) -> None:
    files = libraries_for(platform, tmp_path / "made")
    assert len(files) == 4, "two libraries, each with its declarations"
    for one, tag in WHEEL_TAGS.items():
        wheel = tmp_path / f"mecanum_hil-0-py3-none-{tag}.whl"
        with zipfile.ZipFile(wheel, "w") as archive:
            for made, place in files.items():
                archive.write(made, place)
        assert (list(faults(wheel, one)) == []) == (one == platform)


def test_the_changes_of_a_release_are_the_newest_section() -> None:
    text = newest_changes()
    assert text.startswith("# ")
    assert "\n## " not in text
