"""A worker of the catalogue: ``python -m hil.batch.catalogue.worker`` JSON jobs in, answers with verdicts."""

import sys

from hil.batch.catalogue.runs import Job, lost, perform
from hil.batch.old_worker import serve

if __name__ == "__main__":
    sys.exit(serve(Job, perform, lost))
