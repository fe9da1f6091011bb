"""A robot driven by hand, from a keyboard or a gamepad, through the service that serves it."""
