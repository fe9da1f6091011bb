"""Does things to a served robot at random times and judges it by the truth: ``python -m tools.chaos --minutes 2``.

Half of the time the robot is our firmware behind a line that can be spoilt, half of the time a maker's board without a
time limit, with its guardian. Then there is quiet: the service has to drive again, and everything is ended. It prints
one JSON object, and exits with 1 when wheels moved without a fresh command or the service said what is not true, when
the service did not drive again, a recording cannot be opened, or something is left behind. Everything is in a temporary
folder and on loopback. The same seed gives the same events; when they hit what, the machine decides.
"""

import argparse
import collections
import contextlib
import json
import random
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hil
from hil.core.errors import HilError
from tools.chaos.events import EVENTS, give_order
from tools.chaos.judge import Judge
from tools.chaos.world import KINDS, World, until

QUIET_S = 45.0
_USER_S = 0.1


def main() -> int:
    """Run, print and judge."""
    parser = argparse.ArgumentParser(prog="tools.chaos", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=2.0, help="how long things happen, in all")
    parser.add_argument("--seed", type=int, default=1, help="of what happens")
    parser.add_argument("--world", choices=KINDS, action="append", help="this one; may be repeated")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="keep what the processes wrote")
    options = parser.parse_args()
    worlds = options.world or list(KINDS)
    figures: dict[str, Any] = {"seed": options.seed, "minutes": options.minutes, "worlds": {}}
    with tempfile.TemporaryDirectory(prefix="hil_chaos_", ignore_cleanup_errors=True) as name:
        folder = options.keep or Path(name)
        for number, kind in enumerate(worlds):
            rng = random.Random(f"{options.seed} {kind}")
            seconds = 60.0 * options.minutes / len(worlds)
            figures["worlds"][kind] = chaos(kind, folder.resolve() / f"{number}_{kind}", rng, seconds)
    figures["trouble"] = [f"{kind}: {one}" for kind, found in figures["worlds"].items() for one in found.pop("trouble")]
    print(json.dumps(figures, indent=2))
    return int(bool(figures["trouble"]))


def chaos(kind: str, folder: Path, rng: random.Random, seconds: float) -> dict[str, Any]:
    """Let events happen in one world for that long; ``trouble`` of the result lists the errors."""
    begin_s = time.monotonic()
    with World(KINDS[kind], folder, rng) as world:
        judge = Judge(world)
        trouble: list[str] = []
        happened: collections.Counter[str] = collections.Counter()
        try:
            with _used(world, judge, random.Random(rng.random())):
                if not until(lambda: judge.is_moving, QUIET_S):
                    trouble.append(f"the robot did not drive within {QUIET_S:g} s of the start")
                end_s = time.monotonic() + seconds
                while time.monotonic() < end_s:
                    [event] = rng.choices(list(EVENTS), list(EVENTS.values()))
                    if (words := event(world, judge, rng)) is not None:
                        happened[words] += 1
                        print(f"{time.monotonic() - begin_s:6.1f} s  {words}", file=sys.stderr, flush=True)
                    if world.service.poll() is not None:
                        trouble += filter(None, [world.restart_service()])
                    time.sleep(rng.expovariate(1.0))
                judge.is_moving = False
                if not until(lambda: judge.is_moving, QUIET_S):
                    status = judge.status()
                    why = status and (status["phase"], status["why"])
                    trouble.append(f"the robot did not drive again within {QUIET_S:g} s of quiet: {why}")
        finally:
            judge.close()
        trouble += judge.trouble + world.end()
        recordings = [_opened(path) for path in sorted((folder / "runs").glob("*.rrd"))]
        trouble += [one for one in recordings if isinstance(one, str)]
        return {
            "events": dict(happened.most_common()),
            "services": world.services,
            "truths": judge.records,
            "truths_moving": judge.moved,
            "statuses": judge.statuses,
            "recordings": len(recordings),
            "rows": sum(one for one in recordings if isinstance(one, int)),
            "trouble": trouble,
        }


@contextlib.contextmanager
def _used(world: World, judge: Judge, rng: random.Random) -> Iterator[None]:
    """Let a user give orders in a thread of its own meanwhile."""
    ends = threading.Event()

    def give_orders() -> None:
        while not ends.wait(_USER_S):
            give_order(world, judge, rng)

    thread = threading.Thread(target=give_orders, name="user", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ends.set()
        thread.join()


def _opened(path: Path) -> int | str:
    """Return the rows of a recording, or why it cannot be opened. One that was killed before its first row has none."""
    try:
        return len(hil.load(path).signals["loop.t_s"])
    except HilError as error:
        return 0 if "before its first rows" in str(error) else f"{path.name}: {error}"


if __name__ == "__main__":
    sys.exit(main())
