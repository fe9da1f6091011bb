"""Pose fixes for the fused estimator: simulated from the truth, or received over UDP (hil/estimator/ESTIMATORS.md)."""

from hil.localisation.simulated import SimulatedFixes, SimulatedOptions
from hil.localisation.udp import UdpFixes

__all__ = ["SimulatedFixes", "SimulatedOptions", "UdpFixes"]
