"""``python -m hil.plant.conformance FOLDER LIBRARY VERSION RESULTS LONGEST_S PART...``: the child of the check.

Appends one JSON line to RESULTS when a part begins, what is tried, each problem, and when the part is done: a crash
tells where it happened. A part that takes longer than LONGEST_S ends the process with the exit code HUNG.
"""

import json
import os
import sys
import threading
from pathlib import Path

from fmpy.fmi1 import FMICallException

from hil.plant.conformance.fmi2 import Slave2
from hil.plant.conformance.fmi3 import Slave3
from hil.plant.conformance.order import GATES, HUNG, PARTS, title
from hil.plant.conformance.slave import InstantiationError, Model, NotTestedError, Slave

SLAVES: dict[str, type[Slave]] = {"2.0": Slave2, "3.0": Slave3}


def main(folder: Path, library: Path, version: str, results: Path, longest_s: float, asked: list[str]) -> None:
    """Run the parts that were asked for, up to one that nothing can follow."""
    os.chdir(library.parent)  # some libraries look for others where they are

    def write(**entry: str | bool) -> None:
        with results.open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")

    model = Model(folder, library, SLAVES[version], announce=lambda text: write(trying=text))
    for part in PARTS:
        if title(part) not in asked:
            continue
        write(part=title(part))
        watchdog = threading.Timer(longest_s, os._exit, (HUNG,))
        watchdog.daemon = True
        watchdog.start()
        failed = False
        try:
            for problem in part(model):
                failed = True
                write(problem=problem)
        except NotTestedError as reason:
            write(skipped=str(reason))
        except FMICallException as error:
            failed = True
            write(problem=model.explain(error))
        except InstantiationError as error:
            failed = True
            write(problem=str(error))
        watchdog.cancel()
        write(done=True)
        if failed and part in GATES:
            return


if __name__ == "__main__":
    folder_, library_, version_, results_, longest_, *parts_ = sys.argv[1:]
    main(Path(folder_), Path(library_), version_, Path(results_), float(longest_), parts_)
