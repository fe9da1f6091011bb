"""A worker of a comparison: ``python -m hil.batch.comparison.worker`` JSON jobs in, answers with outcomes."""

import sys

from hil.batch.comparison.runs import Job, lost, perform
from hil.batch.old_worker import serve

if __name__ == "__main__":
    sys.exit(serve(Job, perform, lost))
