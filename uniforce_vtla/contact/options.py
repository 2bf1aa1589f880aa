"""Switches of the contact model: what it includes beyond pressure, drag and dilation."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class ContactOptions:
    """Optional terms of the model, one switch each.

    Attributes:
        friction: Coulomb coefficient of pad against object.
        coulomb_cap: cap each cell's shear at friction × pressure; its excess goes to cells that still stick.
        pin_lever: TacTip pins tilt with the slope of the skin.
        perspective: material pressed towards the camera looks larger.
        cross_talk: uSkin's x and y react to the gradient of pressure.
        noise: per-marker position noise (camera) or count noise (taxel).
        marker_loss: drop single camera markers at random.
    """

    friction: float = 1.0  # rubber on wood or plastic, .8–1.2
    coulomb_cap: bool = True
    pin_lever: bool = True
    perspective: bool = True
    cross_talk: bool = True
    noise: bool = True
    marker_loss: bool = False  # off: the paper's layouts are complete; on for robustness studies
    noise_px: float = 0.3  # standard deviation of a marker's found centre, in pixels of the canonical image
    noise_counts: float = 1.8  # raw standard deviation of real uSkins at rest is 1.1–2.6 counts
    loss_probability: float = 0.01  # per marker and frame (the ViTac 2024 simulation track uses the same)

    def quiet(self) -> ContactOptions:
        """Return these options without randomness."""
        return replace(self, noise=False, marker_loss=False)
