"""Finds out how a robot is wired, step by step: on blocks, then on the floor. ``COMMISSIONING.md`` is for the user.

It may import everything below ``hil.batch``. To add a step, write a method of ``Procedure`` and a name of ``STEPS``.
"""
