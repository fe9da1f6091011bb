"""``python -m hil.addons.fmu_check FOLDER``: the child of the check, which runs an FMU that is unpacked in FOLDER.

Its first line on stdin names the FMU, its library and the parts to run. It reports the begin and the end of each part,
each finding, and every call of the FMU before the call is made: so the parent knows where it crashed or hangs.
"""

import os
from collections.abc import Callable, Sequence
from pathlib import Path

from fmpy.fmi1 import FMICallException

from hil.addons.fmu_check import Kind
from hil.addons.fmu_check.parts import GATES, PARTS, functions, title
from hil.addons.fmu_check.slave import DISCARD, InstantiationError, Model, NotTestedError
from hil.core.errors import BadInputError
from hil.plant.process import Parent


def main() -> None:
    """Run the requested parts on the FMU."""
    parent = Parent()
    job = parent.receive()
    library = Path(job["library"])
    os.chdir(library.parent)  # some libraries look for others in the working directory
    model = Model(Path(job["fmu"]), parent.scratch, library, job["version"], parent.send)
    run_parts(model, job["parts"], parent.send)
    parent.send(doing="at its exit")  # the FMU may have registered functions that run then


def run_parts(model: Model, titles: Sequence[str], report: Callable[..., None]) -> None:
    """Run the parts with these titles. After a failure of one of GATES, or an answer fatal, no more are run."""
    for part in PARTS:
        if title(part) not in titles:
            continue
        report(part=title(part))
        failed = True
        try:
            findings = 0
            for finding in part(model):
                findings += 1
                report(kind=finding.kind, found=finding.text)
            failed = findings > 0
        except NotTestedError as reason:
            failed = False
            report(skipped=str(reason))
        except FMICallException as error:
            # The standard lets an FMU discard a call, but a run would not try another one.
            report(kind=Kind.NEED if error.status == DISCARD else Kind.VIOLATION, found=model.explain(error))
        except InstantiationError as error:
            report(kind=Kind.NEED if error.is_need else Kind.VIOLATION, found=str(error))
        except BadInputError as error:
            if part is functions:  # it cannot be run here, so it is not judged
                report(refused=str(error))
                return
            report(kind=Kind.VIOLATION, found=str(error))
        report(done=True)
        if model.is_fatal or (failed and part in GATES):
            break


if __name__ == "__main__":
    main()
