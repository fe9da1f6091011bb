"""A plant that predicts the user's own robot: drives that show what it is made of, and the fit to their recordings.

May import: `runtime`, `review`, `scenario`, `plant`, `core`.
IDENTIFY.md is for the user, METHOD.md has equations and accuracies. To add a parameter: a row in `RIGID` or `SLIP` of
`before.py`.
"""
