"""A worker of the catalogue: ``python -m hil.catalogue.worker`` takes jobs as lines of JSON, answers with verdicts."""

import sys

from hil.catalogue.runs import Job, lost, perform
from hil.worker import serve

if __name__ == "__main__":
    sys.exit(serve(Job, perform, lost))
