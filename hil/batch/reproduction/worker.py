"""A worker of the reproduction: it takes jobs as lines of JSON and answers with outcomes."""

import sys

from hil.batch.old_worker import serve
from hil.batch.reproduction.runs import Job, lost, perform

if __name__ == "__main__":
    sys.exit(serve(Job, perform, lost))
