"""The golden vectors are what libraries that are not ours make of wheel.dbc, byte for byte."""

import csv
import io

from tests.support.protocol_cases import IDS, VECTORS
from tests.vectors import make


def test_the_tables_are_as_their_maker_writes_them() -> None:
    frames = (VECTORS / "frames.csv").read_bytes().decode()
    assert make.frames(frames) == frames
    assert make.rejected() == (VECTORS / "rejected.csv").read_bytes().decode()


def test_the_maker_keeps_no_row_that_is_wrong() -> None:
    """A wrong byte anywhere in the last column costs its row, and with less than four a message is made anew."""
    frames = (VECTORS / "frames.csv").read_text(encoding="utf-8")
    lines = frames.splitlines(keepends=True)
    spoilt = [
        line if i == 0 else f"{line[:-4]}{'1' if line[-4] != '1' else '2'}{line[-3:]}" for i, line in enumerate(lines)
    ]
    made = list(csv.DictReader(io.StringIO(make.frames("".join(spoilt)))))
    assert [int(row["id"], 16) for row in made] == [number for number in IDS for _ in range(4)]
    assert all(row["serial"] not in "".join(spoilt) for row in made)
    assert make.frames(make.frames(lines[0])) == make.frames(lines[0])
