"""Fuzzes the C decoder, both halves of the protocol, together too, the serial line, and times, under ASan and UBSan.

``python -m tools.fuzz --runs 10000000`` runs each target so often. ``tests/firmware_protocol/fuzz`` has the targets,
their checks after every call, and the mutator that gets past CRC and COBS. An input that breaks a check is kept and
named.

The target ``python`` is the extension module. It needs CPython for that, and hypothesis makes
the calls (``python_calls.py``). That is slower by far: it makes one sequence of calls for 10,000 runs.
"""

import argparse
import csv
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from firmware_protocol.built import FIRMWARE_FLAGS, SOURCES
from tools.build.compiler import compiler

ROOT = Path(__file__).parent.parent
HARNESSES = ROOT / "tests" / "firmware_protocol" / "fuzz"
FRAMES = ROOT / "tests" / "vectors" / "frames.csv"
TARGETS = ("decoder", "line", "client", "node", "direct", "timing")
COMPILERS = ("clang", *(f"clang-{version}" for version in range(22, 13, -1)))
CORE = [source for source in SOURCES if "port" not in source.parts or source.stem in ("host", "direct")]
# Comparisons are not traced: the mutator writes valid frames itself, and a run is 1.5 times as fast.
FUZZ = (
    "-g",
    "-fsanitize=fuzzer,address,undefined,float-cast-overflow",
    "-fno-sanitize-recover=all",
    "-fno-sanitize-coverage=trace-cmp",
)
PYTHON = "python"
SANITIZE = ("-g", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all")
LONGEST = 512
# The choices in front of the node's stream (node_fuzzer.c): IDLE, ARMED, ACTIVE in both modes, 16 bytes a tick.
# Those of the client: 24 calls between the pieces of the stream (client_fuzzer.c): the way to ACTIVE, and others. Those
# of the timing: 40 commands, each sent and then seen in force.
HEADERS = {
    "node": [bytes([start, 15, 0, 0, 0, 0, 255, 0]) for start in range(4)],
    "direct": [bytes([0, 1, 2, 2, 5, 8, 11, 0, 2, 20, 23, 1, repeats]) for repeats in (0, 1, 7, 15)],
    "timing": [
        bytes(b for s in range(40) for b in (6, s, 0, s, 0, 0, 8, s, 2, 0, 0, s + late)) for late in (2, 7, 9, 99)
    ],
    "client": [bytes([mode, 11, 0, 1, 15] + [0, 1, 2, 7, 15] * 3 + [12, 10, 5, 4]) for mode in (16, 17, 32, 33)],
}


class UnavailableError(Exception):
    """libFuzzer is not on this machine; the message says what to install."""


class Outcome(NamedTuple):
    """What a target went through; ``failure`` is its report when a check broke, and ``reproducer`` the input."""

    runs: int
    seconds: float
    features: int
    failure: str | None
    reproducer: Path | None


def compile_shared_part(folder: Path) -> list[Path]:
    """Compile what all targets share into object files. Raises UnavailableError without clang and its runtime."""
    sources = [HARNESSES / "wire_mutator.c", *CORE]
    _compile(["-c", *map(str, sources)], folder)
    return [folder / f"{source.stem}.o" for source in sources]


def _compile(words: list[str], folder: Path) -> None:
    compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
    if compiler is None:
        raise UnavailableError("no clang on this machine; on Debian: apt install clang libclang-rt-dev")
    probe = [compiler, "-fsanitize=fuzzer", "-x", "c", "-", "-o", str(folder / "probe")]
    empty = "int LLVMFuzzerTestOneInput(const char *d, long n) { (void)d; (void)n; return 0; }"
    probed = subprocess.run(probe, input=empty, capture_output=True, text=True, check=False)
    if probed.returncode != 0:
        raise UnavailableError("clang has no libFuzzer here; on Debian: apt install libclang-rt-dev")
    command = [compiler, *FIRMWARE_FLAGS, *FUZZ, *words]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(command)} failed:\n{done.stderr}")


def write_seeds(target: str, folder: Path) -> None:
    """Write the golden frames as first inputs, one by one and all in a row."""
    with FRAMES.open(encoding="utf-8", newline="") as file:
        serial = [bytes.fromhex(row["serial"]) for row in csv.DictReader(file)]
    streams = [*serial, *(b"".join(serial[i : i + 30]) for i in range(0, len(serial), 30))]
    for i, stream in enumerate(streams):
        header = HEADERS[target][i % 4] if target in HEADERS else b""
        (folder / f"seed{i}").write_bytes(header + stream)


def fuzz(target: str, runs: int, seed: int, keep_in: Path, shared: Sequence[Path]) -> Outcome:
    """Run a target with the objects of ``compile_shared_part``. An input that breaks a check is kept in ``keep_in``."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        program = folder / target
        _compile(["-o", target, str(HARNESSES / f"{target}_fuzzer.c"), *map(str, shared)], folder)
        corpus = folder / "corpus"
        corpus.mkdir()
        write_seeds(target, corpus)
        limits = [f"-runs={runs}", f"-seed={seed}", f"-max_len={LONGEST}", "-timeout=10"]
        command = [str(program), *limits, "-print_final_stats=1", f"-artifact_prefix={keep_in}/{target}-", str(corpus)]
        before = set(keep_in.glob(f"{target}-*"))
        began = time.monotonic()
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
        seconds = time.monotonic() - began
        kept = sorted(set(keep_in.glob(f"{target}-*")) - before)
    log = done.stderr
    counted = re.search(r"stat::number_of_executed_units: (\d+)", log)
    features = re.findall(r" ft: (\d+)", log)
    return Outcome(
        int(counted[1]) if counted else 0,
        seconds,
        int(features[-1]) if features else 0,
        None if done.returncode == 0 else log[-4000:],
        kept[0] if kept else None,
    )


def build_sanitised(folder: Path) -> Path:
    """Build the host library under ASan and UBSan. Raises UnavailableError where the compiler has no ASan to load."""
    library = folder / "libwheel_sanitised.so"
    command = [
        *compiler(),
        *FIRMWARE_FLAGS,
        *SANITIZE,
        "-fPIC",
        "-shared",
        "-o",
        str(library),
        *map(str, SOURCES),
        "-lm",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0 or not _runtime().is_file():
        raise UnavailableError(f"{command[0]} makes no library under ASan that CPython can load: {done.stderr[-500:]}")
    return library


def _runtime() -> Path:
    """Return ASan's own library, which has to be there before CPython allocates anything."""
    asked = [*compiler(), "-print-file-name=libasan.so"]
    return Path(subprocess.run(asked, capture_output=True, text=True, check=False).stdout.strip())


def fuzz_python(sequences: int, seed: int, library: Path) -> Outcome:
    """Make so many sequences of calls from CPython to a library of ``build_sanitised``; the report has what failed."""
    # Without CPython's own allocator each object has its own memory, whose bounds ASan knows. CPython leaks by design.
    sanitised = {"WHEEL_HOST_LIBRARY": str(library), "LD_PRELOAD": str(_runtime()), "PYTHONMALLOC": "malloc"}
    environment = os.environ | sanitised | {"ASAN_OPTIONS": "detect_leaks=0"}
    command = [
        sys.executable,
        "-m",
        "tests.firmware_protocol.fuzz.python_calls",
        "--runs",
        str(sequences),
        "--seed",
        str(seed),
    ]
    began = time.monotonic()
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    seconds = time.monotonic() - began
    calls = re.search(r"(\d+) calls", done.stdout)
    failure = None if done.returncode == 0 else (done.stdout + done.stderr)[-4000:]
    return Outcome(int(calls[1]) if calls else 0, seconds, 0, failure, None)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--runs", type=int, default=100_000, help="runs of each target")
    parser.add_argument("--target", choices=(*TARGETS, PYTHON), action="append", help="default: all")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    failed = False
    targets = arguments.target or (*TARGETS, PYTHON)
    with tempfile.TemporaryDirectory() as folder:
        try:
            shared = compile_shared_part(Path(folder)) if targets != [PYTHON] else []
            library = build_sanitised(Path(folder)) if PYTHON in targets else None
        except UnavailableError as error:
            print(f"tools.fuzz: {error}", file=sys.stderr)
            return 2
        for target in targets:
            if target == PYTHON and library is not None:
                outcome = fuzz_python(max(arguments.runs // 10_000, 100), arguments.seed, library)
            else:
                outcome = fuzz(target, arguments.runs, arguments.seed, Path.cwd(), shared)
            failed = _report(target, outcome) or failed
    return int(failed)


def _report(target: str, outcome: Outcome) -> bool:
    """Print what a target went through; return whether a check broke."""
    rate = outcome.runs / max(outcome.seconds, 1e-9)
    reached = f", {outcome.features} features reached" if outcome.features else ""
    verdict = "a check broke" if outcome.failure else "no failure"
    print(f"{target}: {outcome.runs} runs in {outcome.seconds:.0f} s ({rate:.0f}/s){reached}, {verdict}", flush=True)
    if outcome.failure is not None:
        where = "" if outcome.reproducer is None else f"\nthe input is {outcome.reproducer}"
        print(f"{outcome.failure}{where}", file=sys.stderr)
    return outcome.failure is not None


if __name__ == "__main__":
    sys.exit(main())
