"""Pose fixes: the message from outside, its socket, and the simulation; each thing that can be wrong with one."""

import contextlib
import json
import math
import socket
import stat
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2, kstest

from hil.core.errors import BadInputError
from hil.core.private_files import write_private
from hil.core.tokens import token_file
from hil.core.types import NAN, MeasuredPose, Pose, PoseFix, Twist
from hil.estimation.fix_errors import SimulatedOptions
from hil.estimation.simulated_fixes import SimulatedFixes
from hil.estimation.udp_fixes import Refused, UdpFixes, parse, parse_address
from hil.runtime.assembly import RunOptions, run_scenario
from hil.runtime.loop import Loop
from hil.scenario import load
from tools.pose_fix_client import datagram, token_at

TOKEN = "0123456789abcdef"
GOOD: dict[str, Any] = {
    "version": 1,
    "token": TOKEN,
    "age_s": 0.1,
    "x_m": 1.0,
    "y_m": -2.0,
    "heading_rad": 0.5,
    "covariance": [4e-4, 1e-5, 0, 4e-4, 0, 1e-4],
}


def encoded(**changes: object) -> bytes:
    return json.dumps(GOOD | changes).encode()


def without(*names: str) -> bytes:
    return json.dumps({name: value for name, value in GOOD.items() if name not in names}).encode()


def test_a_message_says_when_where_and_how_sure() -> None:
    found = parse(encoded(), TOKEN, 12345.0)
    assert (found.age_s, found.pose) == (0.1, Pose(1.0, -2.0, 0.5))
    assert found.covariance == (4e-4, 1e-5, 0.0, 4e-4, 0.0, 1e-4)
    client = parse(datagram(TOKEN, 1000.25, 1.0, -2.0, 0.5, 0.02, 0.01), TOKEN, 1000.5)
    assert client.pose == found.pose
    assert client.covariance == pytest.approx((4e-4, 0.0, 0.0, 4e-4, 0.0, 1e-4))
    assert client.age_s == 0.25


# Of three sigmas of 20 mm and mrad: heading and position leave 0.24 % of each other's variance.
BY_BOTH = 4e-4 * math.sqrt((1 - 0.0024) / 2)
WRONG = [
    (b"", "malformed"),
    (b"\xff\xfe", "malformed"),
    (b"1.0 2.0 3.0", "malformed"),
    (b"[1, 2, 3]", "malformed"),
    (b"null", "malformed"),
    (b'{"version": 1, "token": "0123456789abcdef"}', "malformed"),
    (b'{"version": 1}', "token"),
    (without("token"), "token"),
    (encoded(token="0123456789abcdeg"), "token"),
    (encoded(token="\ud800"), "token"),
    (encoded(token=None), "token"),
    (json.dumps({"version": 2, "pose": [1, 2, 3]}).encode(), "token"),
    (b"[" * 1000, "malformed"),
    (encoded(surprise=1), "malformed"),
    (encoded(unix_time_s=1.0), "malformed"),
    (without("age_s"), "malformed"),
    (without("covariance"), "malformed"),
    (without("version"), "malformed"),
    (encoded(version=True), "malformed"),
    (encoded(version=1.0), "malformed"),
    (encoded(version="1"), "malformed"),
    (encoded(x_m="1.0"), "malformed"),
    (encoded(x_m=True), "malformed"),
    (encoded(heading_rad=None), "malformed"),
    (encoded(covariance=4e-4), "malformed"),
    (encoded(covariance=[4e-4] * 9), "malformed"),
    (encoded(covariance=[4e-4, 0, 0, 4e-4, 0, "x"]), "malformed"),
    (encoded(version=2), "version"),
    (json.dumps({"version": 2, "token": TOKEN, "pose": [1, 2, 3]}).encode(), "version"),
    (encoded(x_m=NAN), "not_finite"),
    (encoded(y_m=math.inf), "not_finite"),
    (encoded(age_s=NAN), "not_finite"),
    (encoded(heading_rad=10**400), "not_finite"),
    (encoded(x_m=1e7), "not_finite"),
    (encoded(covariance=[NAN, 0, 0, 4e-4, 0, 1e-4]), "not_finite"),
    (encoded(covariance=[0, 0, 0, 0, 0, 0]), "covariance"),
    (encoded(covariance=[-4e-4, 0, 0, 4e-4, 0, 1e-4]), "covariance"),
    (encoded(covariance=[4e-4, 5e-4, 0, 4e-4, 0, 1e-4]), "covariance"),
    (encoded(covariance=[4e-4, 0, 3e-4, 4e-4, 0, 1e-4]), "covariance"),
    (encoded(covariance=[1.147, 0, 0, 2.418e-9, 0.006976, 20124.4]), "covariance"),
    (encoded(covariance=[1e9, 0, 0, 4e-4, 0, 1e-4]), "covariance"),
    (encoded(covariance=[1e-4, 0, 0, 4e-4, 4e-4 * math.sqrt(1 - 0.0024), 4e-4]), "covariance"),
    (encoded(covariance=[4e-4, 0, BY_BOTH, 4e-4, BY_BOTH, 4e-4]), "covariance"),
    (encoded(covariance=[4e-4, 0, 0, 9e-11, 0, 1e-4]), "covariance"),
    (encoded(covariance=[1.0, 0, 0, 0.9e-8, 0, 1e-4]), "covariance"),
    (encoded(covariance=[0.7e6, 0.5e6, 0, 0.7e6, 0, 1e-4]), "covariance"),
    (encoded(covariance=[2e-10, 1.5e-10, 0, 2e-10, 0, 1e-4]), "covariance"),
    (encoded(covariance=[4e-4, 0, 0, 4e-4, 0, 1.01e6]), "covariance"),
    (encoded().ljust(1025), "too_long"),
]


@pytest.mark.parametrize(("data", "cause"), WRONG)
def test_what_is_no_message_is_refused_for_its_cause(data: bytes, cause: str) -> None:
    with pytest.raises(Refused) as refused:
        parse(data, TOKEN, 0.0)
    assert refused.value.cause == cause


@pytest.mark.parametrize(
    "message",
    [
        encoded(x_m=1e6, y_m=-1e6),
        encoded(covariance=[1e6, 0, 0, 1.1e-2, 0, 1e-10]),
        encoded(covariance=[1e-4, 0, 0, 1e-10, 0, 1e6]),
        encoded(covariance=[4e-4, 0, 4e-4 * math.sqrt(1 - 0.0026), 4e-4, 0, 4e-4]),
        encoded(covariance=[0.12505, 0.12495, 0, 0.12505, 0, 1e-4]),  # 0.5 and 0.01 m, at 45 degrees
        encoded().ljust(1024),
    ],
)
def test_what_is_at_a_bound_is_taken(message: bytes) -> None:
    assert parse(message, TOKEN, 0.0).age_s == 0.1


@given(st.binary(max_size=200) | st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=6) | st.dictionaries(st.sampled_from(list(GOOD)), inner, max_size=6),
).map(lambda tree: json.dumps(tree).encode()))  # fmt: skip
def test_nothing_that_is_received_raises_anything_else(data: bytes) -> None:
    with contextlib.suppress(Refused):
        parse(data, TOKEN, 0.0)


@given(st.lists(st.floats(-1, 1), min_size=9, max_size=9))
def test_a_covariance_that_is_taken_can_be_inverted(entries: list[float]) -> None:
    root = np.array(entries).reshape(3, 3)
    p = root @ root.T
    p += (0.01 * p.trace() + 1e-8) * np.eye(3)  # far enough from singular to be taken
    found = parse(encoded(covariance=list(p[np.triu_indices(3)])), TOKEN, 0.0)
    full = np.zeros((3, 3))
    full[np.triu_indices(3)] = found.covariance
    assert np.linalg.eigvalsh(full + np.triu(full, 1).T).min() > 0.0


@pytest.fixture
def port(state_home: None) -> int:
    """A free port, whose receiver wants ``TOKEN``."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        number = int(probe.getsockname()[1])
    write_private(token_file("fixes", number), TOKEN)
    return number


def received(source: UdpFixes, count: int, now_ns: int = 0) -> list[MeasuredPose]:
    """Poll until so many datagrams were read; loopback delivers all of them, in order."""
    fixes: list[MeasuredPose] = []
    give_up = time.monotonic() + 10.0
    while source.figures()["received"] < count:
        assert time.monotonic() < give_up, "loopback lost a datagram"
        fixes += source.poll(now_ns, None)
    return fixes


def test_datagrams_become_fixes_or_are_counted_and_nothing_waits(port: int) -> None:
    source = UdpFixes(f"udp://127.0.0.1:{port}", 1.0, unix_time_s=lambda: 1000.0)
    sent = [data for data, _ in WRONG]
    sent += [
        encoded(age_s=1.001),
        encoded(age_s=-0.011),
        datagram(TOKEN, 998.0, 0, 0, 0, 1, 1),
        datagram(TOKEN, 1001.0, 0, 0, 0, 1, 1),
    ]
    sent += [encoded(), datagram(TOKEN, 999.75, 1.0, -2.0, 0.5, 0.02, 0.01)]
    sent += [encoded(age_s=1.0), encoded(age_s=-0.01)]
    assert list(source.poll(0, None)) == [], "an empty socket is no reason to wait"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for data in sent:
            sender.sendto(data, ("127.0.0.1", port))
    fixes = received(source, len(sent), now_ns=5_000_000_000)
    assert [fix.time_ns for fix in fixes] == [4_900_000_000, 4_750_000_000, 4_000_000_000, 5_010_000_000]
    assert fixes[0].pose == fixes[1].pose == (1.0, -2.0, 0.5)
    refused = source.figures()["refused"]
    assert refused.pop("stale") == refused.pop("future") == 2
    expected = {cause: sum(one == cause for _, one in WRONG) for _, cause in WRONG}
    assert refused == expected
    source.close()
    source.close()


def test_what_waits_before_the_first_tick_is_refused_not_taken_for_new(port: int) -> None:
    """In real time; ``watch`` is entered when the port is open and no tick has been."""

    @contextlib.contextmanager
    def sending(_: Loop) -> Iterator[None]:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for _ in range(3):
                sender.sendto(encoded(age_s=0.0), ("127.0.0.1", port))
        yield

    keys = {"estimator.source": "fused", "estimator.fix": f"udp://127.0.0.1:{port}", "loop.duration_s": 0.1}
    result = run_scenario(load("circle_speed", mode="realtime", set={**keys, "expect": []}), RunOptions(watch=sending))
    assert result.metrics["pose_fixes"]["refused"] == {"waited": 3}


def test_fixes_are_skipped_in_every_tick_without_the_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the loop; what UDP makes of it is above, and takes real time."""
    calls: list[str] = []
    monkeypatch.setattr(SimulatedFixes, "skip", lambda _: calls.append("skip"))
    fault = [{"kind": "reset", "target": "robot", "start_s": 0.1}]
    keys = {"estimator.source": "fused", "loop.duration_s": 0.6, "loop.rearm": True, "fault": fault, "expect": []}
    result = run_scenario(load("circle_speed", set=keys))
    (recovery,) = result.metrics["recoveries"]
    assert len(calls) >= round((recovery["armed_s"] - recovery["lost_s"]) * 200)


def test_a_flood_is_taken_in_portions(port: int) -> None:
    source = UdpFixes(f"udp://127.0.0.1:{port}", 1.0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for _ in range(40):
            sender.sendto(encoded(), ("127.0.0.1", port))
    while not (first := source.poll(0, None)):
        pass
    assert len(first) == 16
    assert len(first) + len(received(source, 40)) == 40
    source.close()


def test_the_token_is_of_this_user_alone_and_whoever_comes_first_makes_it(port: int) -> None:
    file = token_file("fixes", port)
    assert token_at(port) == file
    for first, second in ((token_at, UdpFixes), (UdpFixes, token_at)):
        file.unlink()
        opened = [side(port) if side is token_at else side(f"udp://127.0.0.1:{port}", 1.0) for side in (first, second)]
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
        (receiver,) = [side for side in opened if isinstance(side, UdpFixes)]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.sendto(datagram(file.read_text().strip(), time.time(), 1, 2, 3, 1, 1), ("127.0.0.1", port))
        assert len(received(receiver, 1)) == 1
        receiver.close()


def test_a_port_that_is_taken_is_said() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        with pytest.raises(BadInputError, match=rf"udp://127\.0\.0\.1:{port}' cannot be opened .*; choose another"):
            UdpFixes(f"udp://127.0.0.1:{port}", 1.0)


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("udp://127.0.0.1:5005", ("127.0.0.1", 5005)),
        ("udp://:5005", ("127.0.0.1", 5005)),
        ("udp://localhost:5005", ("127.0.0.1", 5005)),
        ("udp://192.168.1.7:5005", ("192.168.1.7", 5005)),
    ],
)
def test_addresses(text: str, address: tuple[str, int]) -> None:
    assert parse_address(text) == address


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "simulatd",
            "estimator.fix = 'simulatd': no address; "
            'expected "simulated" or udp://127.0.0.1:PORT with a port from 1 to 65535',
        ),
        ("tcp://127.0.0.1:5005", "no address"),
        ("udp://127.0.0.1", "no address"),
        ("udp://127.0.0.1:0", "no address"),
        ("udp://127.0.0.1:70000", "no address"),
        ("udp://127.0.0.1:5005/x", "no address"),
        ("udp:5005", "no address"),
        ("udp://my-robot:5005", "'my-robot' is no IPv4 address in numbers"),
        ("udp://[::1]:5005", "'::1' is no IPv4 address in numbers"),
    ],
)
def test_what_is_no_address_is_said(text: str, words: str) -> None:
    with pytest.raises(BadInputError) as refused:
        parse_address(text)
    assert words in str(refused.value)


MS = 1_000_000


def simulated(seed: int = 1, **changes: float) -> SimulatedFixes:
    return SimulatedFixes(SimulatedOptions(**changes), seed)


def truth_at(time_ns: int) -> PoseFix:
    t_s = time_ns * 1e-9
    return PoseFix(time_ns, Pose(t_s, -t_s, 0.3), Twist(1.0, -1.0, 0.0))


def run_of(source: SimulatedFixes, duration_s: float, period_ms: int = 5) -> list[tuple[int, MeasuredPose]]:
    """Return arrival and fix of a run with a tick each period."""
    found = []
    for now_ns in range(0, round(duration_s * 1e9), period_ms * MS):
        found += [(now_ns, fix) for fix in source.poll(now_ns, truth_at(now_ns))]
    return found


def test_simulated_fixes_come_at_their_rate_and_late() -> None:
    found = run_of(simulated(), 2.0)
    assert [fix.time_ns for _, fix in found] == [n * 100 * MS for n in range(19)]
    assert all(now_ns - fix.time_ns == 100 * MS for now_ns, fix in found)


def residuals(found: list[tuple[int, MeasuredPose]]) -> np.ndarray:
    return np.array([np.array(fix.pose) - np.array(truth_at(fix.time_ns).pose) for _, fix in found])


def test_their_errors_are_what_the_covariance_says() -> None:
    found = run_of(simulated(rate_hz=200.0), 5.0)
    errors = residuals(found)
    sigma = np.sqrt([found[0][1].covariance[i] for i in (0, 3, 5)])
    assert sigma == pytest.approx([0.02, 0.02, 0.01])
    distances = ((errors / sigma) ** 2).sum(axis=1)
    assert kstest(distances, chi2(3).cdf).pvalue > 0.001
    assert np.abs((errors / sigma).mean(axis=0)).max() < 4.0 / math.sqrt(len(errors)), "they are off to no side"


def test_one_seed_gives_one_run_and_an_option_changes_what_it_says_alone() -> None:
    plain = run_of(simulated(), 5.0)
    assert run_of(simulated(), 5.0) == plain
    assert run_of(simulated(seed=2), 5.0) != plain
    thinned = run_of(simulated(dropout_probability=0.5), 5.0)
    assert 0 < len(thinned) < len(plain)
    assert set(thinned) < set(plain)
    fouled = run_of(simulated(outlier_probability=0.3, outlier_m=2.0), 5.0)
    far = {fix.time_ns for (_, fix), (_, other) in zip(fouled, plain, strict=True) if fix != other}
    apart = [math.dist(fix.pose[:2], other.pose[:2]) for (_, fix), (_, other) in zip(fouled, plain, strict=True)]
    assert 0 < len(far) < len(plain)
    assert sorted({round(distance, 9) for distance in apart}) == [0.0, 2.0]


def test_fixes_that_are_noisier_than_they_tell_have_so_many_times_the_errors() -> None:
    plain, noisier = (residuals(run_of(simulated(noisier=times), 3.0)) for times in (1.0, 3.0))
    assert noisier == pytest.approx(3.0 * plain)


def test_an_outlier_is_off_in_any_direction_and_turned_by_at_most_as_many_radians() -> None:
    errors, clean = (
        residuals(run_of(simulated(rate_hz=200.0, outlier_probability=p, outlier_m=2.0), 5.0)) for p in (1.0, 0.0)
    )
    x, y, turned = (errors - clean).T
    assert np.hypot(x, y) == pytest.approx(np.full(len(x), 2.0))
    quarters = np.histogram(np.arctan2(y, x), bins=4, range=(-math.pi, math.pi))[0]
    assert quarters.min() > 0.2 * len(x)
    assert 1.9 < turned.max() < 2.0
    assert -2.0 < turned.min() < -1.9


def test_a_gap_has_no_fixes() -> None:
    source = simulated(gap_start_s=1.0, gap_end_s=2.0)
    times = [fix.time_ns // MS for _, fix in run_of(source, 3.0)]
    assert times == [*range(0, 1000, 100), *range(2000, 2900, 100)]
    assert source.figures() == {"made": 30, "outliers": 0, "dropped": 10, "received": 19}


def test_after_a_reset_fixes_are_stamped_by_the_robots_new_clock() -> None:
    """The truth's clock goes on; what was on its way has stamps of the old one, and is lost."""
    source = SimulatedFixes(SimulatedOptions(), 1, truth_age_ns=2 * MS)
    source.poll(7_002 * MS, truth_at(7_000 * MS))
    source.restart()
    assert list(source.poll(7_102 * MS, None)) == []
    source.poll(22 * MS, truth_at(7_120 * MS))
    (fix,) = source.poll(120 * MS, None)
    assert fix.time_ns == 20 * MS
    assert fix.pose.x_m == pytest.approx(7.12, abs=0.1)


@pytest.mark.parametrize("pose", [Pose(NAN, 0.0, 0.0), Pose(0.0, math.inf, 0.0)])
def test_a_truth_that_is_no_number_makes_no_fix(pose: Pose) -> None:
    source = simulated()
    assert list(source.poll(0, None)) == []
    assert list(source.poll(0, PoseFix(0, pose, Twist(0.0, 0.0, 0.0)))) == []
    assert source.figures()["made"] == 0
