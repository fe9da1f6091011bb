"""What a mutant changes in a run, at the ports between its parts: ``hil verify`` puts known defects into a suite.

``mutant.py`` has a mutant and applies it, and has the changes of frames on the link. ``change.py`` has the changes of
numbers, such as a wrong sign or a delay. ``wrappers.py`` puts them around law, guard, estimator, robot, reference and
poses, and between firmware and plant. To add a kind of change: a row of ``CHANGES`` or ``FLOWS``; a port: a row of
``PORTS`` in ``wrappers.py``.
"""
