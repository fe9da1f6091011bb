"""Finds out how a robot is wired, step by step: on blocks, then on the floor. ``COMMISSIONING.md`` is for the user.

To add a step, write a method of ``Procedure`` and a name of ``STEPS``.
"""
