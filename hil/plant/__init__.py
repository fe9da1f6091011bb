"""Opens, maps, checks and steps FMUs (the simulated robot). C code steps them through the firmware's plant port,
or through many windows of recorded torques in one call (`windows.py`).

May import: `core`, `firmware_protocol`, `plant_fmu`.
To add a check of FMUs: a function in `conformance/`.
"""
