"""RoboMaster C620 and C610: driver, probe, frames, and the emulated device."""
