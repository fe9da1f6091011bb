"""What a mutant changes in a run, at the ports between its parts: ``hil verify`` puts known defects into a suite.

``change.py`` has the changes of numbers, such as a wrong sign or a delay; ``wrappers.py`` puts them around law, guard,
estimator, robot, reference and poses; ``exchange.py`` between firmware and plant; ``frames.py`` on the link. May import
what ``runtime`` may. To add a kind of change: a row of ``CHANGES``; a port: a row of ``PORTS`` in ``wrappers.py``.
"""
