"""hil review of real runs: why one failed, two side by side, the page, the overlay, exports, and an old recording."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pyarrow.parquet as pq
import pytest
import scipy.signal
from hypothesis import given
from hypothesis import strategies as st

from hil.core.errors import BadInputError
from hil.core.signals import SIGNAL_NAMES, unit_of
from hil.record.properties import SUMMARY_PROPERTY
from hil.review import changes, differences, figures, read, review
from hil.review.export import write_export
from hil.review.html_page import write_document
from hil.review.overlay import write_overlay
from hil.review.page import page
from hil.review.panels import read_for_page
from hil.review.plots import Curve, thinned
from hil.review.spectra import LEAST_SAMPLES, spectrum
from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import load
from tests.examples import share_of_examples
from tests.processes import hil

OLD = Path(__file__).parent / "recordings" / "circle_speed_ca92b7a.rrd"
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
    return page(runs, [figures(run) for run in runs])


class Tags(HTMLParser):
    """Collects what a page has, and that each tag is closed."""

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
    one, other = figures(run), review(OLD)
    assert changes(run, run) == []
    for row in differences(one, one):
        assert row.difference == 0
        assert row.verdict in ("same", None)
    swapped = differences(one, other), differences(other, one)
    opposite = {"better": "worse", "worse": "better", "same": "same", None: None}
    assert [opposite[row.verdict] for row in swapped[0]] == [row.verdict for row in swapped[1]]


def test_a_page_of_two_runs_needs_nothing_but_itself(page_of_two: str) -> None:
    tags = assert_self_contained(page_of_two)
    assert tags.seen.count("figure") == 9
    assert len(page_of_two) < 2_500_000
    policy = re.findall(r'Content-Security-Policy" content="([^"]*)"', page_of_two)[0]
    assert policy.startswith("default-src 'none'; ")
    assert re.fullmatch(r"script-src 'sha256-\S+' 'sha256-\S+'", policy.split("; ")[2]), "no eval, no other script"
    for words in (
        "Expectations",
        "Wheel torques",
        "Spectra",
        "Lateness",
        "Link statistics",
        "Events",
        "circle_speed.toml:9",
    ):
        assert words in page_of_two
    assert "afdsc" in page_of_two


def test_an_old_recording_has_a_page_too() -> None:
    run = read_for_page(OLD)
    text = page([run], [figures(run)])
    assert_self_contained(text)
    assert "What happened" in text


def test_a_page_shows_what_a_scenario_says_as_text_and_not_as_tags(tmp_path: Path) -> None:
    run = read_for_page(OLD)
    whole = figures(run)
    for name, values in run.signals.items():
        run.signals[name] = values[:0]  # no plots, which show nothing of these
    odd = whole | {"failure": "<script>alert('1')</script> & more", "scenario": "<b>"}
    write_document(tmp_path / "page.html", page([run], [odd]))
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert_self_contained(text)
    assert "&lt;script&gt;alert(&#x27;1&#x27;)&lt;/script&gt; &amp; more" in text
    with pytest.raises(BadInputError, match=r"must end in \.html"):
        write_document(tmp_path / "page.txt", page([run], [odd]))


def test_an_export_has_every_value_by_its_name(failed: Path, tmp_path: Path) -> None:
    run = read(failed)
    for ending in ("csv", "parquet", "mcap"):
        write_export(run, tmp_path / f"run.{ending}")
    back = read(tmp_path / "run.mcap")
    table, frame = pd.read_csv(tmp_path / "run.csv"), pd.read_parquet(tmp_path / "run.parquet")
    assert (tmp_path / "run.csv").read_text().partition("\n")[0].split(",") == list(run.signals)
    assert sorted(table.columns) == sorted(frame.columns) == sorted(back.signals) == sorted(SIGNAL_NAMES)
    for name, values in run.signals.items():
        for there in (table[name].to_numpy(), frame[name].to_numpy(), back.signals[name]):
            np.testing.assert_array_equal(there, values, err_msg=name)
    assert (back.summary, back.properties, back.events) == (run.summary, run.properties, run.events)
    schema = pq.read_schema(tmp_path / "run.parquet")
    for name in SIGNAL_NAMES:
        assert schema.field(name).metadata[b"unit"].decode() == unit_of(name)
        assert schema.field(name).metadata[b"meaning"]
    assert json.loads(schema.metadata[b"summary"])["passed"] is False


def test_an_overlay_is_for_the_viewer_and_holds_both_runs_over_one_time(failed: Path, tmp_path: Path) -> None:
    import rerun.chunk as rrc

    file = tmp_path / "overlay.rrd"
    write_overlay(failed, OLD, file)
    for which, path in (("first", failed), ("second", OLD)):
        signals = read(path).signals
        chunks = rrc.RrdReader(file).stream().filter(content=f"/wheel/fl/speed_rad_s/{which}", has_timeline="t")
        batches = [chunk.to_record_batch() for chunk in chunks]
        values = np.concatenate([batch.column("Scalars:scalars").flatten().to_numpy() for batch in batches])
        t_s = np.concatenate([batch.column("t").cast("int64").to_numpy() for batch in batches]) / 1e9
        np.testing.assert_array_equal(values, signals["wheel.fl.speed_rad_s"])
        np.testing.assert_allclose(t_s, signals["loop.t_s"], atol=1e-9)
    assert len(rrc.RrdReader(file).blueprints()) == 1
    with pytest.raises(BadInputError, match="an overlay of two runs"):
        read(file)


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
    found = figures(run)
    assert found["saturation_s"] is None
    assert found["effort_n_m_s"] is None
    assert "no signal guard.saturated" in found["reasons"]["saturation_s"]
    assert found["overshoot_m"] == review(OLD)["overshoot_m"]
    del run.signals["loop.t_s"]
    with pytest.raises(BadInputError, match=r"no signal 'loop\.t_s'"):
        figures(run)


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (["--overlay", "o.rrd"], "an overlay needs two runs"),
        ([OLD, OLD], "takes one, or two"),
        ([OLD, "--export", "x.csv"], "it is for one run"),
        (["--export", "x.xlsx"], "must end in .csv, .parquet or .mcap"),
        (["--html", "missing/x.html"], "there is no folder"),
        ([OLD, "--overlay", OLD], "this is one of the reviewed recordings"),
    ],
)
def test_what_a_review_cannot_do_is_one_sentence(options: list[str | Path], problem: str) -> None:
    done = hil("review", OLD, *options)
    assert (done.returncode, done.stdout) == (2, "")
    assert problem in done.stderr
    assert done.stderr.count("\n") == 1


@given(st.integers(LEAST_SAMPLES, 3000), st.sampled_from([200.0, 1000.0]), st.integers(0, 2**32 - 1))
@share_of_examples(0.25)
def test_a_spectrum_is_that_of_scipy(count: int, rate_hz: float, seed: int) -> None:
    values = np.random.default_rng(seed).normal(size=count) + 3.0
    found = spectrum(np.arange(count) / rate_hz, values)
    assert found is not None
    size = round(found.stretch_s * rate_hz)
    frequency_hz, density = scipy.signal.welch(values, rate_hz, "hann", size, size // 2, detrend="constant")
    np.testing.assert_allclose(found.frequency_hz, frequency_hz)
    np.testing.assert_allclose(found.density, density, rtol=1e-9, atol=1e-15)


def test_a_spectrum_leaves_out_gaps_and_needs_enough_without_one() -> None:
    t_s, values = np.arange(1000) / 1000.0, np.sin(np.arange(1000.0))
    values[300] = np.nan
    part = spectrum(t_s[301:], values[301:])
    whole = spectrum(t_s, values)
    assert part is not None
    assert whole is not None
    np.testing.assert_array_equal(whole.density, part.density)
    values[::LEAST_SAMPLES] = np.nan
    assert spectrum(t_s, values) is None
    assert spectrum(t_s[:2], values[:2]) is None


@given(st.integers(0, 5000), st.integers(0, 2**32 - 1))
@share_of_examples(0.25)
def test_a_thinned_curve_keeps_its_extremes_and_its_order(count: int, seed: int) -> None:
    y: npt.NDArray[np.float64] = np.random.default_rng(seed).normal(size=count)
    curve = thinned(Curve("", np.arange(count, dtype=np.float64), y), 100)
    assert len(curve.x) <= max(count if count <= 100 else 0, 102)
    assert (np.diff(curve.x) >= 0).all()
    if count:
        assert (curve.y.min(), curve.y.max()) == (y.min(), y.max())
        np.testing.assert_array_equal(y[curve.x.astype(int)], curve.y)
