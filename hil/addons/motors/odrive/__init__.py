"""ODrive over CANSimple: driver, probe, frames, and the emulated device (ODRIVE.md)."""
