"""WHEELTEC bases with a C50X board: driver, probe, frames, and the emulated device (WHEELTEC.md)."""
