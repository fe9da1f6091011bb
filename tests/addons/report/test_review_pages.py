"""hil review of real runs: why one failed, two side by side, the page, exports, and an old recording."""

import csv
import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from hil.addons.report import review_command
from hil.addons.report.difference import changes, differences
from hil.addons.report.panels import read_for_page
from hil.addons.report.review_command import write_export
from hil.addons.report.review_page import page
from hil.core.errors import BadInputError
from hil.core.signals import unit_of
from hil.judge.judged_run import Failure
from hil.judge.recorded import judged_run, review
from hil.judge.run_json import to_json
from hil.pages.html_page import write_document
from hil.record.properties import SUMMARY_PROPERTY
from hil.record.reader import read
from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import load
from tests.support.made_runs import made_runs
from tests.support.processes import hil

OLD = Path(__file__).parents[2] / "recordings" / "circle_speed_ca92b7a.rrd"
EXPECT = 'expect=[{signal="loop.t_s",below=9.0},{signal="error.planar_m",from_s=0.2,below=0.001}]'


def recorded(path: Path, *sets: str) -> Path:
    run_scenario(load("circle_speed", set=["loop.duration_s=0.5", *sets]), RunOptions(record=path))
    return path


@pytest.fixture(scope="module")
def failed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("failed") / "failed.rrd", EXPECT)


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("other") / "other.rrd", "controller.law=afdsc", "loop.seed=2")


@pytest.fixture(scope="module")
def page_of_two(failed: Path, other: Path) -> str:
    runs = [read_for_page(path) for path in (failed, other)]
    return page(runs, [judged_run(run) for run in runs])


class Tags(HTMLParser):
    """Collects the contents of a page, and checks that each tag is closed."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.ids: list[str] = []
        self.seen: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.append(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href", "data")]
        self.ids += [value or "" for name, value in attrs if name == "id"]
        if tag not in ("meta", "link", "img", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if self.open and self.open[-1] == tag:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def assert_self_contained(text: str) -> Tags:
    tags = Tags()
    tags.feed(text)
    tags.close()
    assert tags.open == []
    assert all(address.startswith("#") for address in tags.addresses)
    assert not {"link", "img", "iframe", "object"} & set(tags.seen)
    without_scripts = re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)
    assert re.findall(r"url\((?!#)|@import", without_scripts) == []
    assert {address[1:] for address in tags.addresses} <= set(tags.ids)
    return tags


def test_an_expectation_of_a_run_that_was_cut_off_is_checked_over_what_there_is(failed: Path, tmp_path: Path) -> None:
    whole = failed.read_bytes()
    cut = tmp_path / "cut.rrd"
    cut.write_bytes(whole[: whole.index(SUMMARY_PROPERTY.encode())])  # it is written after the rows
    found = review(cut)
    assert found["passed"] is None
    assert found["failure"].endswith("no end: how the run ended is not known")
    assert "has no end" in found["notes"][0]
    assert [row["signal"] for row in found["expect"]] == ["loop.t_s", "error.planar_m"]


def test_two_runs_side_by_side_say_what_is_better_and_what_was_different(failed: Path, other: Path) -> None:
    done = hil("review", failed, other, "--json")
    found = json.loads(done.stdout)
    rows = {row["name"]: row for row in found["differences"]}
    first, second = found["runs"]
    row = rows["effort_n_m_s"]
    assert row["difference"] == second["effort_n_m_s"] - first["effort_n_m_s"]
    assert row["verdict"] == ("better" if row["difference"] < 0 else "worse")
    assert rows["deadline_misses"]["verdict"] == "same"
    assert rows["ticks"]["verdict"] is None
    assert rows["expect"]["first"] == 1
    changed = {change["key"]: (change["first"], change["second"]) for change in found["changes"]}
    assert changed["controller.law"] == ("dsc", "afdsc")
    assert changed["loop.seed"] == (1, 2)
    assert "robot.mass_kg" not in changed


def test_the_text_of_two_runs_says_first_what_was_changed_and_leaves_the_machine_out(failed: Path, other: Path) -> None:
    done = hil("review", failed, other)
    assert done.returncode == 0, done.stderr
    lines = [line for line in done.stdout.splitlines() if str(failed) not in line and str(other) not in line]
    assert max(map(len, lines)) <= 80
    titles = [line for line in lines if line.endswith(":") and not line.startswith(" ")]
    assert titles[:2] == ["What was changed:", "Worse in the second run:"]
    assert "Better in the second run:" in titles
    changed = lines[lines.index("What was changed:") + 1 :]
    assert changed[0].startswith("  code of the law: "), "code, then gains, then what the scenario has"
    assert changed.index("  controller.law: dsc -> afdsc") < changed.index("  loop.seed: 1 -> 2")
    assert changed.index("  loop.seed: 1 -> 2") < len(changed) - 1
    told = "\n".join(lines)
    assert "scenario_sha256" not in told
    for noise in ("tick p50", "times real time", "deadline misses"):
        assert noise not in told
        assert noise in hil("review", failed, other, "--all").stdout


def test_the_differences_of_a_run_and_itself_are_none(failed: Path) -> None:
    run = read(failed)
    one, other = judged_run(run), judged_run(read(OLD))
    assert changes(run, run) == []
    for row in differences(one, one):
        assert row.difference == 0
        assert row.verdict in ("same", None)
    swapped = differences(one, other), differences(other, one)
    opposite = {"better": "worse", "worse": "better", "same": "same", None: None}
    assert [opposite[row.verdict] for row in swapped[0]] == [row.verdict for row in swapped[1]]


def test_a_page_of_two_runs_needs_nothing_but_itself(page_of_two: str) -> None:
    tags = assert_self_contained(page_of_two)
    assert tags.seen.count("figure") == 6
    assert len(page_of_two) < 2_500_000
    policy = re.findall(r'Content-Security-Policy" content="([^"]*)"', page_of_two)[0]
    assert policy.startswith("default-src 'none'; ")
    assert re.fullmatch(r"script-src 'sha256-\S+' 'sha256-\S+'", policy.split("; ")[2]), "no eval, no other script"
    for words in (
        "Expectations",
        "Wheel torques",
        "Link statistics",
        "Events",
        "circle_speed.toml:9",
    ):
        assert words in page_of_two
    assert "afdsc" in page_of_two


def test_an_old_recording_has_a_page_too() -> None:
    run = read_for_page(OLD)
    text = page([run], [judged_run(run)])
    assert_self_contained(text)
    assert "What happened" in text


def test_a_page_shows_what_a_scenario_says_as_text_and_not_as_tags(tmp_path: Path) -> None:
    run = read_for_page(OLD)
    whole = judged_run(run)
    for name, values in run.signals.items():
        run.signals[name] = values[:0]  # no plots, which show nothing of these
    failure = Failure("<script>alert('1')</script> & more", "LinkError", 1.0)
    odd = replace(whole, failure=failure, identity=whole.identity._replace(scenario="<b>"))
    write_document(tmp_path / "page.html", page([run], [odd]))
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert_self_contained(text)
    assert "&lt;script&gt;alert(&#x27;1&#x27;)&lt;/script&gt; &amp; more" in text
    with pytest.raises(BadInputError, match=r"must end in \.html"):
        write_document(tmp_path / "page.txt", page([run], [odd]))


@pytest.mark.parametrize("piece", [7, 25, 100_000])
def test_an_export_has_every_row_whatever_the_size_of_its_pieces(
    piece: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A missing value is an empty cell or a null, and not a number that a reader may show as one."""
    monkeypatch.setattr(review_command, "_ROWS_AT_ONCE", piece)
    (run, _), _ = made_runs()
    signals = {name: values[:50] for name, values in run.signals.items()}
    signals["error.y_m"][[0, 6, 7, 24, 49]] = np.nan
    signals["error.x_m"][:4] = [np.inf, -np.inf, 5e-324, 0.1]
    run = replace(run, signals=signals, summary={"passed": False})
    for ending in ("csv", "parquet"):
        write_export(run, tmp_path / f"run.{ending}")
    expected = {name: [None if math.isnan(one) else one for one in values.tolist()] for name, values in signals.items()}
    with (tmp_path / "run.csv").open(newline="") as file:
        head, *rows = csv.reader(file)
    assert head == list(signals)
    columns = zip(head, zip(*rows, strict=True), strict=True)
    found = {name: [float(cell) if cell else None for cell in cells] for name, cells in columns}
    assert found == expected
    table = pq.read_table(tmp_path / "run.parquet")
    assert table.to_pydict() == expected
    for name in signals:
        assert table.schema.field(name).metadata[b"unit"].decode() == unit_of(name)
        assert table.schema.field(name).metadata[b"meaning"]
    about = {name.decode(): text.decode() for name, text in table.schema.metadata.items()}
    assert {name: about[name] for name in run.properties} == run.properties
    assert json.loads(about["summary"]) == {"passed": False}
    assert json.loads(about["events"])[1] == {"t_s": 0.6, "level": "WARN", "text": "fault begins: push"}


def test_an_old_recording_is_read_and_what_it_lacks_is_said() -> None:
    found = review(OLD)
    assert found["ticks"] == 40
    assert found["made"]["commit"] == "ca92b7a90e78"
    assert found["tracked_s"] is None
    unchecked, lacking = found["notes"][:2]
    assert "a version without check values recorded it" in unchecked
    assert "it lacks " in lacking
    assert "estimator.sigma_position_m" in lacking
    assert read(OLD).signals["loop.t_s"][-1] == pytest.approx(0.195)


def test_a_figure_whose_signal_is_missing_has_that_for_a_reason() -> None:
    run = read(OLD)
    for name in ("guard.saturated", "wheel.rl.current_a"):
        del run.signals[name]
    found = to_json(judged_run(run))
    assert found["saturation_s"] is None
    assert found["effort_n_m_s"] is None
    assert "no signal guard.saturated" in found["reasons"]["saturation_s"]
    assert found["overshoot_m"] == review(OLD)["overshoot_m"]
    del run.signals["loop.t_s"]
    with pytest.raises(BadInputError, match=r"no signal 'loop\.t_s'"):
        to_json(judged_run(run))


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ([OLD, OLD], "takes one, or two"),
        ([OLD, "--export", "x.csv"], "it is for one run"),
        (["--export", "x.xlsx"], "must end in .csv or .parquet"),
        (["--html", "missing/x.html"], "there is no folder"),
        (["--html", OLD], f"page {OLD}: this is one of the reviewed recordings; choose another name"),
    ],
)
def test_what_a_review_cannot_do_is_one_sentence(options: list[str | Path], problem: str) -> None:
    done = hil("review", OLD, *options)
    assert (done.returncode, done.stdout) == (2, "")
    assert problem in done.stderr
    assert done.stderr.count("\n") == 1
