"""FMUs: opened with care, mapped, checked, and stepped from C through the firmware's plant port.

May import: `core`, `firmware_protocol`, `plant_fmu`.
To add a check of FMUs: a part in `conformance/`.
"""
