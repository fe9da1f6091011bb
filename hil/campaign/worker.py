"""A process that does runs of a campaign: ``python -m hil.campaign.worker`` takes jobs as lines of JSON."""

import sys

from hil.campaign.jobs import Job, lost
from hil.campaign.work import perform
from hil.worker import serve

if __name__ == "__main__":
    sys.exit(serve(Job, perform, lost))
