"""Thousands of runs of one scenario: over axes, laws, faults and seeds, resumable, on one machine or many.

``campaign.py`` is what the command uses. A process that does runs imports ``work.py``, without Arrow and Dask; a worker
of Dask imports ``cluster.py``, without a robot.
"""
