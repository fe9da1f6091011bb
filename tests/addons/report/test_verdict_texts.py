"""The words of a verdict, and of the page of a run, as a viewer shows them."""

from collections.abc import Mapping
from typing import Any

from hil.addons.report.verdict_text import page, running, verdict


def test_the_words_of_each_verdict() -> None:
    named = {"scenario_name": "one", "law": "dsc"}

    def said(summary: Mapping[str, Any] | None, *troubles: str, failed_s: float | None = None) -> str:
        told = {"end_s": 1.25, "failed_s": failed_s, "next_part": None, "troubles": troubles}
        return verdict(named, summary, **told)  # type: ignore[arg-type]

    about = "(one, law dsc)"
    assert running(named, []) == f"# RUNNING {about}\n\nNo expectation is violated so far."
    assert running(named, ["a *b*", "c", "a *b*"]) == f"# RUNNING {about}\n\n- a \\*b\\*\n- c"
    assert verdict(named, None, end_s=1.25, failed_s=None, next_part=2, troubles=["late"]) == (
        f"# RUNNING {about}\n\nThis file ends at t = 1.25 s; the run goes on in file 2."
    )
    assert said(None, "late") == (
        f"# NO VERDICT {about}\n\nThe run was killed or interrupted: its recording ends at t = 1.25 s, before the run "
        "was judged.\n\n- late"
    )
    assert said({"passed": None}) == (
        f"# NOT JUDGED {about}\n\nThe recording ends at t = 1.25 s; it has nothing to be judged by."
    )
    assert said({"passed": True}) == (
        f"# PASSED {about}\n\n- Nothing broke, but the scenario expects nothing: it has no [[expect]]."
    )
    faults = [{"text": "drop", "applied": 2}, {"text": "push", "applied": 3}]
    assert said({"passed": True, "expect": [{"text": "a: held"}], "fault": faults}) == (
        f"# PASSED {about}\n\n- a: held\n- Faults: drop, applied 2 times; push, applied 3 times"
    )
    why = [("expectation", f"reason {n}") for n in range(4)]
    four = "".join(f"\n- reason {n}" for n in range(4))
    assert said({"passed": False, "why": why}, failed_s=0.5) == f"# FAILED at t = 0.5 s {about}\n{four}"
    assert said({"passed": False, "why": [*why, ("allow", "five")]}) == (
        f"# FAILED {about}\n{four}\n- and 1 more: see the tab Run"
    )
    ended = {"passed": False, "failure": "gone", "why": [("failure", "gone"), ("allow", "stale")]}
    rows = [{"text": f"to {end_s}", "applied": 1, "end_s": end_s} for end_s in (1.0, 1.25, 1.5)]
    assert said(ended | {"fault": rows}) == (
        f"# FAILED at t = 1.25 s {about}\n\n- gone\n- In force then: the fault to 1.25.\n"
        "- In force then: the fault to 1.5.\n- stale"
    )


def test_the_page_has_the_figures_and_then_the_properties() -> None:
    told = {
        "scenario_name": "one", "scenario": "{}", "gains": '{"k1_1_s": 3.0, "k2_1_s": 4}', "machine": "a|b",
        "law_sha256": "0123456789abcdef", "my_own": "x",
        "reference_file_sha256": '{"a.csv": "0123456789abcdef", "b.csv": null}', "scenario_sources": "{}",
    }  # fmt: skip
    properties_table = (
        "| run | |\n|---|---|\n| scenario | one |\n| options of the law | k1_1_s = 3.0, k2_1_s = 4 |\n"
        "| machine | a\\|b |\n"
        "| code of the law | 0123456789ab |\n| my own | x |\n"
        "| file of the reference | a.csv 0123456789ab, b.csv not known |\n"
    )
    assert page(told, None) == page(told, {}) == properties_table
    figures = "| figure | |\n|---|---|\n| passed | yes |\n| effort | 3 N·m·s |\n"
    assert page(told, {"page": [("passed", "yes"), ("effort", "3 N·m·s")]}) == f"{figures}\n{properties_table}"
    assert page({"gains": "{}"}, None).endswith("| options of the law | none |\n")
