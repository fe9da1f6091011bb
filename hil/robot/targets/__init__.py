"""Boards in front of the plant: the firmware as an ARM binary, run by an emulator, or by a board on a line.

``qemu`` is QEMU's netduinoplus2, a process with two serial lines. ``unicorn`` is the chip of ``machine``, in this
process, with a serial line or CAN. firmware_protocol/TARGETS.md says what each of them does not model. ``board`` is a
real one, of which only the line to its plant port is here. It imports what
``hil.robot`` may; a new target has a row in ``TARGETS`` and a subclass of ``EmulatedBoard``.
"""
