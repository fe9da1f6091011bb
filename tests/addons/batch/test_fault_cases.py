"""The catalogue's cases: the reference has them all."""

from hil.addons.batch.catalogue.fault_cases import CASES, DURATION_S
from hil.faults.kinds import KINDS
from tests.support.processes import ROOT
from tools import fault_pages


def test_the_reference_has_every_kind_and_case() -> None:
    text = fault_pages.sections()
    assert all(f"### {kind.name}\n" in text for kind in KINDS)
    assert all(f"| {case.name} |" in text for case in CASES)
    page = (ROOT / "hil" / "faults" / "FAULTS.md").read_text(encoding="utf-8")
    assert f"{DURATION_S:g} s of a circle" in page
