"""A process that does runs of a campaign: ``python -m hil.batch.campaign.worker`` takes jobs as lines of JSON."""

import sys

from hil.batch.campaign.jobs import Job, lost
from hil.batch.campaign.work import perform
from hil.batch.worker import serve

if __name__ == "__main__":
    sys.exit(serve(Job, perform, lost))
