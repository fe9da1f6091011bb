"""``hil catalogue``: every fault alone and in pairs, over every kind of link, each run judged for safety.

``plan.py`` has the trials, ``runs.py`` does one in a worker process with the judges of ``judge.py`` and ``motors.py``,
``verdicts.py`` runs them all and gives a verdict on each.
"""

from hil.batch.catalogue.plan import Request
from hil.batch.catalogue.verdicts import Verdict, catalogue

__all__ = ["Request", "Verdict", "catalogue"]
