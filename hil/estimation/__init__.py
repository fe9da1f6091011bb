"""Estimators of pose and twist: ground truth, odometry, or odometry with pose fixes (ESTIMATORS.md).

May import: `core`. Estimators are pure: they get received data and have no clock.
To add an estimator: one file here and its name in `estimators.py`. To add an option: the dataclass of its table.
"""
