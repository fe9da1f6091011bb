"""mjbots moteus over CAN FD: driver, probe, frames, and the emulated device (MOTEUS.md)."""
