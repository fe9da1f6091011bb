"""Many runs: campaign, comparison of laws, fault catalogue, reproduction of the paper; `pool.py` has the processes.

May import: `runtime`, `review` and what these may.
To add a kind of batch: a folder with its plan, its run and its page.
"""
