"""Boards that run the firmware as an ARM binary in front of the plant, in an emulator or for real; see README.md."""
