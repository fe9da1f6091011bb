"""Thousands of runs of one scenario: over axes, laws, faults and seeds, resumable, on one machine or many.

``load.py`` reads a campaign's file, ``points.py`` has its runs and checks them, ``campaign.py`` does them with the
batch engine, ``judged.py`` computes the results, and ``page.py`` and ``pictures.py`` show them.
"""
