"""The checks of ``hil doctor``: functions that yield findings. They change nothing and open no port.

A check that does not apply to the operating system yields nothing. To add one: a function here, a line in `doctor.py`.
"""
