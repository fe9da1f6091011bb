"""``hil campaign``: thousands of runs of a scenario, over axes, laws, faults and seeds, resumable, on many machines."""
