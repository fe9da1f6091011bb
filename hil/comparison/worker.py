"""A worker of a comparison: ``python -m hil.comparison.worker`` takes jobs as lines of JSON, answers with outcomes."""

import sys

from hil.comparison.runs import Job, lost, perform
from hil.worker import serve

if __name__ == "__main__":
    sys.exit(serve(Job, perform, lost))
