"""``hil decode``: traces of other tools, of a run, and damaged ones, in our terms."""

import json
import os
import random
import subprocess
from pathlib import Path

import can
import pytest

from hil.addons.report.trace import trace_decoder as decode
from tests.support.processes import HIL, environment, hil
from tests.support.traced_runs import one_second_of_frames, traced

EVERYTHING = decode.Selection.of([], 0, 10)


NOISE = random.Random(5).randbytes(2000)
GOLDEN = """\
   0.000000  1      Tx  WHEEL_COMMAND       fl_rad_s 1.5 rad/s  fr_rad_s -2.25 rad/s  rr_rad_s 10.0 rad/s \
 rl_rad_s 0.015625 rad/s  sequence 17 \
 session 5
   0.005000  1      Rx  TICK                time_us 1234567 µs  sequence 17  command_age_ms 3 ms  state ACTIVE \
 parts 3  snapshot 200
   0.006000  1      Rx  foreign             18FF1234 [3] 01 02 03
   0.007000  1      Rx  foreign             123 [0]
   0.008000  1      Rx  TICK                080 not valid: length [2] 01 02
   0.009000  1      Rx  STATUS              100 not valid: range [8] 0f 0f 0f 0f 0f 0f 0f 0f
   0.010000  1      Rx  foreign             080 remote [0]
   0.011000  1      Rx  error               error frame, or bytes that are no frame
   1.000000  1      Rx  STATUS              state FAULT  mode SPEED  fault OVERCURRENT  fault_wheel RR \
 stop_reason FAULT  reset_cause POWER_ON  nonce 4661  arm_refusal NONE  limited 12
"""


def written(path):
    with can.Logger(path) as log:
        for message in one_second_of_frames():
            log.on_message_received(message)
    return path


@pytest.mark.parametrize("ending", ["blf", "log"])
def test_decode_prints_a_foreign_tool_s_trace_in_our_terms(tmp_path, ending):
    done = hil("decode", written(tmp_path / f"bus.{ending}"))
    expected = GOLDEN.replace("  1      ", "  vcan0  ") if ending == "log" else GOLDEN
    assert (done.stdout, done.stderr, done.returncode) == (expected, "", 0)


def test_decode_reads_candump_s_log_without_directions(tmp_path):
    path = tmp_path / "candump.log"
    path.write_text("(1700000000.000000) vcan0 040#6000EE038A001051\n(1700000000.005000) vcan0 1FFFFFFF#R\n")
    lines = hil("decode", path).stdout.splitlines()
    assert lines[0].split()[:5] == ["0.000000", "vcan0", "Rx", "WHEEL_COMMAND", "fl_rad_s"]
    assert lines[1].split()[:5] == ["0.005000", "vcan0", "Rx", "foreign", "1FFFFFFF"]


def test_decode_takes_what_is_asked_for(tmp_path):
    path = written(tmp_path / "bus.blf")
    lines = GOLDEN.splitlines()
    assert hil("decode", path, "--message", "status").stdout.splitlines() == [lines[5], lines[8]]
    both = hil("decode", path, "--message", "TICK", "--message", "foreign").stdout.splitlines()
    assert both == [lines[i] for i in (1, 2, 3, 4, 6)]
    assert hil("decode", path, "--from", "0.005", "--to", "0.007").stdout.splitlines() == lines[1:4]


def test_decode_that_finds_nothing_says_so(tmp_path):
    path = written(tmp_path / "bus.log")
    done = hil("decode", path, "--message", "HELLO_IDENTITY")
    assert (done.returncode, done.stdout) == (0, "")
    assert done.stderr == f"hil: none of the 9 frames of {path} is what was asked for\n"


def test_decode_raw_takes_no_frame_for_ours(tmp_path):
    """As in a trace of other makers' motors, whose identifiers are those of our messages."""
    path = written(tmp_path / "bus.blf")
    lines = hil("decode", path, "--raw").stdout.splitlines()
    assert [line.split()[3] for line in lines] == ["foreign"] * 7 + ["error", "foreign"]
    assert lines[4].split()[4:] == ["080", "[2]", "01", "02"]
    records = [json.loads(line) for line in hil("decode", path, "--raw", "--json").stdout.splitlines()]
    assert not any("signals" in record or record["sender"] for record in records)


@pytest.mark.parametrize("driver", ["odrive", "wheeltec"])
def test_decode_says_that_another_maker_s_trace_is_not_ours(tmp_path, driver):
    path = tmp_path / "bus.log"
    short = (
        "--set",
        "loop.duration_s=0.5",
        "--set",
        "expect=[]",
        "--record",
        "none",
        "--link",
        f"can:virtual/{driver}",
    )
    run = hil("run", "circle_speed", "--lenient", "--set", f"device.driver={driver}", *short, "--trace", path)
    assert run.returncode == 0, run.stderr
    done = hil("decode", path)
    assert {line.split()[3] for line in done.stdout.splitlines()} == {"foreign"}
    assert done.stderr.startswith(f"hil: note: {path} has no TICK of our firmware")
    assert hil("decode", path, "--raw").stderr == ""


def test_decode_takes_what_a_host_alone_has_sent_for_ours(tmp_path):
    path = tmp_path / "host.log"
    path.write_text("(1700000000.0) can0 040#6000EE038A001051\n(1700000000.1) can0 123#00\n")
    done = hil("decode", path)
    assert (done.stdout.split()[3], done.stderr) == ("WHEEL_COMMAND", "")


def test_decode_gives_each_frame_as_json(tmp_path):
    path = written(tmp_path / "bus.blf")
    records = [json.loads(line) for line in hil("decode", path, "--json").stdout.splitlines()]
    assert len(records) == 9
    assert records[1]["signals"]["time_us"] == 1_234_567
    assert (records[1]["names"], records[1]["sender"]) == ({"state": "ACTIVE"}, "ROBOT")
    assert (records[2]["id"], records[2]["extended"], records[2]["sender"]) == (0x18FF1234, True, None)
    assert {record["channel"] for record in records} == {"1"}
    assert records[4]["refusal"] == "not valid: length"


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["nowhere.blf"], "nowhere.blf: No such file or directory; expected a trace, .blf or .log"),
        (
            ["bus.asc"],
            "bus.asc: unknown file extension; expected .blf or .log, into which 'python -m can.logconvert' converts "
            "others",
        ),
        (
            ["bus.log", "--message", "WHEEL_COMAND"],
            "--message 'WHEEL_COMAND': there is no such message; did you mean 'WHEEL_COMMAND'?",
        ),
        (
            ["bus.log", "--raw", "--message", "TICK"],
            "--message 'TICK' with --raw: raw frames have no names; leave one out",
        ),
        (
            ["bus.log", "--from", "3", "--to", "2"],
            "--from 3 --to 2: expected the first not to be later than the second",
        ),
    ],
)
def test_decode_refuses_in_one_sentence(tmp_path, arguments, sentence):
    written(tmp_path / "bus.log")
    done = hil("decode", *arguments, cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (2, "", f"hil: {sentence}\n")


@pytest.mark.parametrize("ending", ["blf", "log"])
@pytest.mark.parametrize(
    "content", [b"", b"\0" * 500, b"LOGG" + b"\xff" * 300, b"no trace at all\n" * 20, os.urandom(2000)]
)
def test_what_is_no_trace_is_refused_in_one_sentence(tmp_path, ending, content):
    path = tmp_path / f"bus.{ending}"
    path.write_bytes(content)
    done = hil("decode", path)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1, done.stderr
    assert "no frames could be read" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("share", [0.05, 0.31, 0.5, 0.83, 0.95])
@pytest.mark.parametrize("ending", ["blf", "log"])
def test_a_trace_that_is_cut_is_read_as_far_as_it_goes(ending, share, tmp_path_factory):
    whole = _a_whole_trace(tmp_path_factory, ending)
    expected = list(decode.read(whole, EVERYTHING))
    cut = whole.with_name(f"cut.{ending}")
    content = whole.read_bytes()
    cut.write_bytes(content[: int(share * len(content))])
    reading = decode.read(cut, EVERYTHING)
    got = list(reading)
    assert [entry.frame.payload for entry in got] == [entry.frame.payload for entry in expected[: len(got)]]
    assert "cut" in reading.trouble or "no frames" in reading.trouble
    if ending != "blf":
        assert len(got) == pytest.approx(share * len(expected), abs=0.05 * len(expected))


_WHOLE: dict[str, Path] = {}


def _a_whole_trace(factory, ending):
    if ending not in _WHOLE:
        _WHOLE[ending] = factory.mktemp("whole") / f"bus.{ending}"
        traced(_WHOLE[ending])
    return _WHOLE[ending]


def test_decode_ends_quietly_when_nobody_reads_on(tmp_path):
    path = tmp_path / "bus.log"
    traced(path)
    process = subprocess.Popen(
        [*HIL, "decode", str(path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment()
    )
    assert process.stdout.readline()
    process.stdout.close()
    assert process.stderr.read() == b""
    assert process.wait() == 0
