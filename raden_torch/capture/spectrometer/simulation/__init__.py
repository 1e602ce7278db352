"""A rig that is not there: two processes that speak the instruments' own bytes over ptys."""

from raden_torch.capture.spectrometer.simulation.faults import Fault
from raden_torch.capture.spectrometer.simulation.simulated_rig import (
    Conditions,
    SimulatedRig,
    simulated_rig,
)

__all__ = ["Conditions", "Fault", "SimulatedRig", "simulated_rig"]
