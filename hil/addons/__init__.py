"""What one run does not need: an add-on is a folder here, found by its entry points and imported by nobody."""
