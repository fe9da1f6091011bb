"""``hil reproduce``: section IV of Nguyen Minh et al. 2023 through the wire and the FMU, beside what the paper prints.

``plan.py`` has the cases, ``runs.py`` does them, ``verdicts.py`` says which results are reproduced; ``page.py`` and
``pictures.py`` show them.
"""

from hil.batch.reproduction.runs import NotWrittenError, reproduce

__all__ = ["NotWrittenError", "reproduce"]
