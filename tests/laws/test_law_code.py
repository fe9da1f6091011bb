"""The hash of a law's code: its coverage, that nothing is executed for it, and that it tells two runs apart."""

import hashlib
from pathlib import Path

import pytest
from typer.testing import CliRunner

import hil
from hil.addons.report.difference import changes
from hil.addons.report.verdict_text import HASHES
from hil.cli.main import app
from hil.laws import code
from hil.laws.law_registry import forget_law, law_sha256, load_law, shipped_laws
from hil.record.reader import read

SHIPPED = shipped_laws()

LAW = """
from hil.core.types import NO_GAINS, WheelCommand, ZERO_WHEELS, CommandMode

class Still:
    gains = NO_GAINS
    def reset(self, state, reference): ...
    def update(self, reference, state, applied, dt_s):
        return WheelCommand(CommandMode.SPEED, ZERO_WHEELS, ZERO_WHEELS)
"""


@pytest.fixture(autouse=True)
def _a_new_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(code, "_held", {})


def digest(file: Path) -> str | None:
    """Return the hash of a law in a file, as a new process finds it."""
    code._held.clear()
    return law_sha256(f"{file.name}:Law", file.parent)


def test_a_file_alone_has_the_hash_of_its_bytes_and_is_not_executed(tmp_path: Path) -> None:
    law = tmp_path / "law.py"
    law.write_text("import numpy\nimport hil.core.types\nraise SystemExit\n")
    assert digest(law) == hashlib.sha256(law.read_bytes()).hexdigest()
    law.write_text("this is no Python")
    assert digest(law) == hashlib.sha256(law.read_bytes()).hexdigest()
    law.unlink()
    assert digest(law) is None


@pytest.mark.parametrize(
    ("imported", "changed", "covered"),
    [
        ("import tuning", "tuning.py", True),
        ("from tuning import K", "tuning.py", True),
        ("def f():\n    import tuning", "tuning.py", True),
        ("import tables.first", "tables/first.py", True),
        ("from tables import first", "tables/first.py", True),
        ("from tables import first", "tables/__init__.py", True),
        ("import through", "tuning.py", True),
        ("import tuning", "other.py", False),
        ("from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import tuning", "tuning.py", False),
    ],
)
def test_modules_of_its_own_folder_are_covered(imported: str, changed: str, covered: bool, tmp_path: Path) -> None:
    law = tmp_path / "law.py"
    law.write_text(imported + "\n")
    (tmp_path / "tables").mkdir()
    for name in ("tuning.py", "other.py", "tables/__init__.py", "tables/first.py"):
        (tmp_path / name).write_text("K = 1\n")
    (tmp_path / "through.py").write_text("import tuning, law\n")  # in a circle
    before = digest(law)
    (tmp_path / changed).write_text("K = 2\n")
    assert (digest(law) != before) is covered


def test_a_law_in_a_package_covers_what_it_imports_of_it(tmp_path, monkeypatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    package = tmp_path / "my_laws_of_today"
    (package / "inner").mkdir(parents=True)
    for name in ("__init__.py", "inner/__init__.py", "unused.py", "gains.py"):
        (package / name).write_text("K = 1\n")
    (package / "inner/law.py").write_text("from ..gains import K\n" + LAW)
    spec = "my_laws_of_today.inner.law:Still"

    def now() -> str | None:
        code._held.clear()
        return law_sha256(spec, tmp_path)

    before = now()
    (package / "unused.py").write_text("K = 2\n")
    assert now() == before
    (package / "gains.py").write_text("K = 2\n")
    assert now() != before
    assert law_sha256("no_such_package.law:Law", tmp_path) is None


def test_our_own_laws_have_one_for_each_file_which_covers_what_they_share() -> None:
    hashes = {law_sha256(name, Path()) for name in SHIPPED}
    assert len(hashes) == len({law.__module__ for law in SHIPPED.values()})
    assert None not in hashes
    code._held.clear()
    law_sha256("afdsc", Path())
    assert {"surface.py", "afdsc.py", "model.py"} <= {file.name for file in code._held}


def test_a_module_that_was_imported_counts_as_it_was_until_it_is_executed_anew(tmp_path, monkeypatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    law = tmp_path / "still_of_today.py"
    law.write_text(LAW)
    spec = "still_of_today:Still"
    load_law(spec, tmp_path)
    before = law_sha256(spec, tmp_path)
    law.write_text(LAW + "# edited\n")
    assert law_sha256(spec, tmp_path) == before, "Python runs what it has imported"
    forget_law(spec, tmp_path)
    assert law_sha256(spec, tmp_path) == hashlib.sha256(law.read_bytes()).hexdigest()


def test_a_pair_review_says_that_the_laws_file_changed(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    law = Path("law.py")
    short = {"loop.duration_s": 0.1, "expect": [], "controller.law": "./law.py:Still", "controller.gains": {}}
    Path("still.toml").write_text('extends = "circle_speed"\n')
    for name, text in (("old.mcap", LAW), ("new.mcap", LAW.replace("gains = NO_GAINS", "gains = NO_GAINS\n    a = 1"))):
        law.write_text(text)
        hil.run("./still.toml", set=short, record=name)
        assert read(Path(name)).properties["law_sha256"] == hashlib.sha256(text.encode()).hexdigest()
    told = changes(read(Path("old.mcap")), read(Path("new.mcap")))
    assert [change.key for change in told] == ["law_sha256"]
    done = CliRunner().invoke(app, ["review", "old.mcap", "new.mcap"])
    assert done.exit_code == 0, done.exception
    first, second = (read(Path(name)).properties["law_sha256"][:12] for name in ("old.mcap", "new.mcap"))
    lines = done.stdout.splitlines()
    changed = lines.index("What was changed:")
    assert lines[changed + 1 : changed + 3] == [f"  code of the law: {first} -> {second}", ""]


def test_of_an_older_recording_a_hash_is_not_known(tmp_path: Path) -> None:
    old = read(Path(__file__).parents[1] / "recordings" / "circle_speed_ca92b7a.rrd")
    assert not set(HASHES) - {"fmu_sha256"} & set(old.properties)
    path = tmp_path / "new.mcap"
    hil.run("circle_speed", set={"loop.duration_s": 0.1, "expect": []}, record=path)
    words = {change.key: change.words() for change in changes(old, read(path))}
    assert words["law_sha256"][:2] == ("code of the law", "not recorded")
    keys = [change.key for change in changes(old, read(path))]
    assert keys.index("law_sha256") < keys.index("loop.duration_s"), "what was driven with comes first"
