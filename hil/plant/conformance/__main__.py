"""``python -m hil.plant.conformance FOLDER``: the child of the check, which runs an FMU that is unpacked in FOLDER.

Its first line on stdin names the FMU, its library and the parts to run. It reports the begin and the end of each part,
each finding, and every call of the FMU before the call is made: so the parent knows where it crashed or hangs.
"""

import os
from pathlib import Path

from fmpy.fmi1 import FMICallException

from hil.plant.conformance.findings import Kind
from hil.plant.conformance.order import GATES, PARTS, title
from hil.plant.conformance.slave import DISCARD, InstantiationError, Model, NotTestedError, Slave
from hil.plant.conformance.versions import Slave2, Slave3
from hil.plant.process import Parent

SLAVES: dict[str, type[Slave]] = {"2.0": Slave2, "3.0": Slave3}


def main() -> None:
    """Run the parts that were asked for, up to one that nothing can follow."""
    parent = Parent()
    report = parent.send
    job = parent.receive()
    library = Path(job["library"])
    os.chdir(library.parent)  # some libraries look for others where they are
    model = Model(Path(job["fmu"]), parent.scratch, library, SLAVES[job["version"]], report)
    for part in PARTS:
        if title(part) not in job["parts"]:
            continue
        report(part=title(part))
        failed = False
        try:
            for finding in part(model):
                failed = True
                report(kind=finding.kind, found=finding.text)
        except NotTestedError as reason:
            report(skipped=str(reason))
        except FMICallException as error:
            failed = True
            # A call may be discarded: the FMU is as it was. But nobody here tries another one then.
            kind = Kind.NEED if error.status == DISCARD else Kind.VIOLATION
            report(kind=kind, found=model.explain(error))
        except InstantiationError as error:
            failed = True
            report(kind=Kind.VIOLATION, found=str(error))
        report(done=True)
        if failed and part in GATES:
            break
    report(trying="", doing="at its exit")  # for which the FMU may have registered something


if __name__ == "__main__":
    main()
