"""Emulated boards: the firmware as an ARM binary, run by an emulator in front of the plant.

``qemu`` is QEMU's netduinoplus2, a process with two serial lines. ``unicorn`` is the chip of ``machine``, in this
process, with a serial line or CAN. firmware_protocol/TARGETS.md says what each of them does not model. It imports what
``hil.robot`` may; a new target has a row in ``TARGETS`` and a subclass of ``EmulatedBoard``.
"""
