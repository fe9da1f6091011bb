"""Texts that a person has read: a test compares what is shown today with the text of a file.

``HIL_GOLDEN=write`` in the environment writes the file anew; then read the difference.
"""

import os
from pathlib import Path


def assert_golden(path: Path, text: str) -> None:
    """Compare a text with that of a file, line by line."""
    if os.environ.get("HIL_GOLDEN") == "write":
        path.write_text(text, encoding="utf-8")
    assert text.splitlines() == path.read_text(encoding="utf-8").splitlines(), "HIL_GOLDEN=write accepts it"
