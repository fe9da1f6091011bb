"""Drivers for the motor controllers of other makers (DIALECTS.md): one file each, pure, behind one port."""

from hil.dialects.registry import DIALECTS, dialect, driver_names

__all__ = ["DIALECTS", "dialect", "driver_names"]
