"""Driving a robot by hand, from a keyboard or a gamepad, through its service."""
