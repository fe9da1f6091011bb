"""Motor controllers of other makers: a folder each, with driver, emulated device, settings and page (DRIVERS.md).

May import: `robot`, `wire`, `plant`, `core`.
To add a maker: a folder with `driver.py` and `emulated.py`, and a row in `registry.py`; in another package an entry
point of the group `hil.drivers` (`port.py` says what a driver is; `four_motors.py` has what four controllers share).
"""
