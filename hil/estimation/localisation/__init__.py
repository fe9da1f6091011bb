"""Pose fixes for the fused estimator: simulated from the truth, or received over UDP (hil/estimation/ESTIMATORS.md)."""

from hil.estimation.localisation.simulated import SimulatedFixes, SimulatedOptions
from hil.estimation.localisation.udp import UdpFixes

__all__ = ["SimulatedFixes", "SimulatedOptions", "UdpFixes"]
