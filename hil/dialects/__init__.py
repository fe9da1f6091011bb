"""Drivers for the motor controllers of other makers (DIALECTS.md): one file each, pure, behind one port."""
