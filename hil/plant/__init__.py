"""Opens, maps, checks and steps FMUs (the simulated robot). C code steps them through the firmware's plant port,
or through many windows of recorded torques in one call (`window_stepper.py`).

May import: `core`, `firmware_protocol`, `plant_fmu`.
"""
