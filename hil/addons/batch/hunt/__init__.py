"""``hil hunt``: a search for a run that breaks an expectation, and the smallest such run."""
