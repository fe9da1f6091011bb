"""A reference of another package: found by its name, listed, checked, and named in the errors that it raises."""

import hashlib
import sys
from pathlib import Path

import pytest

import hil
from hil.cli.list import listing
from hil.core.errors import BadInputError
from hil.references import make_reference
from hil.runtime.provenance import ingredients
from hil.scenario import load
from tests.support.outside import outside_package

SWAY = """
    import math
    from dataclasses import dataclass
    from typing import ClassVar

    from hil.core.types import Acceleration, Pose, Reference, Twist

    @dataclass(frozen=True)
    class Sway:
        '''To and fro along x.'''

        reach_m: float
        rate_rad_s: float = 1.0
        ends: ClassVar[bool] = False

        def __post_init__(self):
            if self.reach_m <= 0.0:
                raise ValueError(f"reach_m = {self.reach_m}: expected more than 0")

        @property
        def span_s(self):
            return math.tau / self.rate_rad_s

        def at(self, t_s):
            w, x = self.rate_rad_s, self.reach_m * math.cos(self.rate_rad_s * t_s)
            v = -self.reach_m * w * math.sin(w * t_s)
            return Reference(Pose(x, 0.0, 0.0), Twist(v, 0.0, 0.0), Acceleration(-w * w * x, 0.0, 0.0))
"""


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Return a function that installs a package whose module registers ``sway``."""

    def installed(text: str = SWAY, value: str = "outside_package:Sway") -> Path:
        return outside_package(tmp_path, monkeypatch, text, {"hil.references": {"sway": value}})

    return installed


def refusal(options: object = None) -> str:
    with pytest.raises(BadInputError) as caught:
        make_reference("sway", {"reach_m": 0.3} if options is None else options)
    return str(caught.value)


@pytest.mark.parametrize("kind", ["sway", "outside_package:Sway"])
def test_it_is_followed_by_its_name_and_its_code_is_named_in_the_recording(install, kind):
    folder = install()
    given = {"reference": {"kind": kind, "reach_m": 0.2}, "loop.duration_s": 0.2, "expect": []}
    result = hil.run("circle_speed", set=given)
    assert result.failure is None
    assert result.signals["reference.x_m"][0] == pytest.approx(0.2)
    code = hashlib.sha256((folder / "outside_package.py").read_bytes()).hexdigest()
    assert ingredients(load("circle_speed", set=given))["reference_sha256"] == code
    assert "reference_sha256" not in ingredients(load("circle_speed"))


def test_the_list_names_the_package_and_loads_nothing(install):
    install("raise SystemExit('loaded')")
    header, rows = listing("references")
    assert header == ("reference", "package", "meaning")
    assert ("sway", "outside-package", "outside_package:Sway") in rows
    assert "outside_package" not in sys.modules


def test_its_options_are_checked_like_those_of_shipped_references(install):
    install()
    assert make_reference("sway", {"reach_m": 2}).at(0.0).pose.x_m == 2.0
    assert "reach_m" in refusal({"rech_m": 1.0})
    assert "did you mean 'reference.reach_m'?" in refusal({"rech_m": 1.0})
    assert "reference.reach_m is missing" in refusal({})
    assert "expected a number" in refusal({"reach_m": "far"})
    assert "reach_m = -1.0: expected more than 0" in refusal({"reach_m": -1.0})
    with pytest.raises(BadInputError, match=r"--set: .*rech_m.*did you mean 'reference.reach_m'"):
        load("circle_speed", set={"reference.kind": "sway", "reference.rech_m": 1.0})


def test_a_name_nearby_is_proposed(install):
    install()
    with pytest.raises(BadInputError, match=r"reference.kind = 'swya': unknown; did you mean 'sway'"):
        make_reference("swya", {})


@pytest.mark.parametrize(
    ("text", "value", "message"),
    [
        (SWAY, "outside_package:Missing", "'outside_package:Missing' cannot be loaded: AttributeError"),
        ("1 / 0", "outside_package:Sway", "ZeroDivisionError: division by zero, at {file}:1 (1 / 0)"),
        ("raise SystemExit('gone')", "outside_package:Sway", "cannot be loaded: SystemExit: gone"),
        ("Sway = 3", "outside_package:Sway", "3 is no class; expected ends, span_s and at(t_s)"),
        (SWAY.replace("def at(", "def on("), "outside_package:Sway", "Sway has no at; expected ends, span_s and at"),
        (
            SWAY.replace("return math.tau", "return 1 / 0"),
            "outside_package:Sway",
            "ends and span_s failed at {file}:22 (return 1 / 0 / self.rate_rad_s): ZeroDivisionError",
        ),
    ],
)
def test_a_broken_one_gives_one_sentence(install, text, value, message):
    folder = install(text, value)
    found = refusal()
    assert found.startswith("reference.kind = 'sway', of the package outside-package: ")
    assert message.format(file=folder / "outside_package.py") in found
    assert "\n" not in found


@pytest.mark.parametrize(
    ("ending", "message"),
    [("return None #", "at returned None, expected a hil.core.types.Reference"), ("1 / 0 #", "at failed at ")],
)
def test_one_that_fails_on_the_way_is_named(install, ending, message):
    install(SWAY.replace("return Reference", f"{ending} Reference"))
    with pytest.raises(BadInputError, match=f"of the package outside-package: {message}"):
        make_reference("sway", {"reach_m": 0.3}).at(0.0)
