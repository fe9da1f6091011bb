"""``hil hunt``: a search for a run that breaks an expectation, and the smallest such run.

``tables.py`` has the keys of a hunt's file, ``space.py`` the values and faults that it allows, and ``cases.py`` the
scenario and the job of each case. ``search.py`` chooses the next cases by the margins so far, ``shrink.py`` makes a
found case smaller, ``hunt.py`` does all this on the batch engine, and ``saved.py`` writes the case as a scenario.
HUNT.md is the user's page.
"""
