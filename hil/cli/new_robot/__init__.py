"""The questions about a user's own robot, and the texts of its files, for ``hil init`` and ``hil probe``."""
