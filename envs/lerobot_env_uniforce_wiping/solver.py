"""How finely physics is solved: the control rate, the physics steps inside it, the solver's effort."""

from __future__ import annotations

from dataclasses import dataclass

CONTROL_HZ = 30.0
READS = 4  # force samples averaged over a control step


@dataclass(frozen=True)
class SolverSettings:
    """Speed against accuracy of the physics; ``uniforce-physics`` charts both (docs/results/physics.png)."""

    substeps: int = 4  # physics steps per force sample: 480 Hz; at 240 Hz the pads' shear springs break loose
    noslip_iterations: int = 8  # without them a held eraser creeps out of the hand

    @property
    def physics_hz(self) -> float:
        """Physics steps per second."""
        return CONTROL_HZ * READS * self.substeps

    @property
    def timestep_s(self) -> float:
        """Duration of a physics step."""
        return 1 / self.physics_hz
