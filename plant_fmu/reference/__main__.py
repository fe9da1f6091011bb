"""Compares the built FMUs with the reference results, or makes the results anew.

``python -m plant_fmu.reference`` writes them with the FMI 2.0 FMU; ``--check`` writes nothing, runs the FMUs of both
versions, and exits 1 when one deviates.
"""

import argparse
import sys

import plant_fmu
from plant_fmu import reference


def main() -> None:
    """Write or check every case, a line each."""
    parser = argparse.ArgumentParser(prog="plant_fmu.reference", description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 when an FMU deviates")
    check = parser.parse_args().check
    versions = (2, 3) if check else (2,)
    if missing := [path for path in map(plant_fmu.path, versions) if not path.exists()]:
        sys.exit(f"{missing[0]} does not exist; run python -m tools.build.fmu")
    cases = reference.read_cases().values()
    if not check:
        for case in cases:
            reference.write(case, reference.run(case, plant_fmu.path()))
            print(case.results)
        return
    deviating = [case for case in cases for fmi in versions if not _agrees(case, fmi)]
    sys.exit(1 if deviating else 0)


def _agrees(case: reference.Case, fmi: int) -> bool:
    try:
        found = reference.largest_deviation(case, reference.run(case, plant_fmu.path(fmi)))
    except ValueError as error:
        print(error)
        return False
    agrees = found.size <= case.tolerance
    print(
        f"{case.name}, FMI {fmi}.0: {'agrees' if agrees else 'DEVIATES'}; {found.column} at {found.time_s:g} s "
        f"is off by {found.size:.1e} of its largest value, {case.tolerance:.1e} allowed"
    )
    return agrees


if __name__ == "__main__":
    main()
