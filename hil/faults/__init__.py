"""Faults on demand: every kind as data (``kinds``), its page (``page``), and what acts on the signals of a tick."""
