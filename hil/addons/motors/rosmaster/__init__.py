"""Yahboom's Rosmaster expansion board: driver, probe, frames, and the emulated device (ROSMASTER.md)."""
