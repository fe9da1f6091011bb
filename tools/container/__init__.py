"""A container of the project, and ``python -m tools.container``, which runs its steps without a container engine."""
