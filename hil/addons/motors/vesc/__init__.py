"""VESC over CAN and UART: driver, probe, frames, and the emulated device (VESC.md)."""
