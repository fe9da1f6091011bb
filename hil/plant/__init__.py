"""The plant: FMUs opened, checked, and stepped from C through the firmware's plant port."""
