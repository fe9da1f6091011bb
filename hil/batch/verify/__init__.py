"""``hil verify``: how much a green run of a suite is worth. Known defects are put in, one at a time.

``mutants/*.toml`` has the catalogue, a file a room; ``catalogue.py`` reads it and checks it; ``suite.py`` has the
scenarios and test files of a suite; ``run.py`` does one in a worker process; ``plan.py`` says which is next;
``suggest.py`` finds the expectation that would have noticed a survivor; ``verify.py`` does it all, and ``page.py`` is
its page. To add a mutant: a row of the file of its room.
"""
