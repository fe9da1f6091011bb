"""The run-time conformance test: runs an unpacked co-simulation FMU through the calls and claims of FMI 2.0 or 3.0.

``python -m hil.plant.conformance FOLDER`` is the child process of ``hil.plant.tools.check``: it runs the parts of
``parts.py`` and ``misuse.py`` one after another; ``findings.py`` has the kinds of what they find. ``slave.py`` has the
FMU as the parts see it, of either version.
Only call sequences that the standard allows are used, but for those of ``illegal_calls``; in particular nothing is
read after an input was set and before the next step (FMI 2.0 section 4.2.4).
"""
