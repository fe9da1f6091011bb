"""Makers' motor controllers as emulated devices, each written from its maker's format, in front of the plant."""
