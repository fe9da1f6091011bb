"""``hil compare``: laws under the same scenario and seed, through the wire, at their best and at their worst.

``plan.py`` has the laws and the jobs, ``conditions.py`` what they run under, ``result.py`` the results, ``page.py`` and
``pictures.py`` show it. ``cases.py`` draws random cases, and ``robust.py`` tries laws in them.
"""

from hil.batch.comparison.plan import Request, compare
from hil.batch.comparison.result import Comparison

__all__ = ["Comparison", "Request", "compare"]
