"""Control laws: pure functions of reference, state and time step; no clock, no link, no plant."""
