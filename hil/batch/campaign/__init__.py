"""Thousands of runs of one scenario: over axes, laws, faults and seeds, resumable, on one machine or many.

``load.py`` reads a campaign's file, ``points.py`` has its runs, ``campaign.py`` has them done by the batch engine,
``judged.py`` says what they came to, and ``page.py`` and ``pictures.py`` show it.
"""
