"""The firmware as an ARM binary, run by an emulator in front of the plant: the rung between host library and board.

``qemu`` is QEMU's netduinoplus2, a process with two serial lines; ``unicorn`` the chip of ``machine``, in this process,
with serial line or CAN. firmware_protocol/TARGETS.md says what each of them does not model.
"""
