"""Materials of a pad, as far as simulating it needs; all of it physical.

Anchors: the paper's gels are 25×25×4 mm and reach 12 N at 1.0 to 1.1 mm (GelSight, uSkin) and
4.6 mm (TacTip). A sphere on a bonded layer then needs E of .3 to 1 MPa. Real TacTips give 3.3 to
4.7 N/mm.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Layer:
    """One material, from the skin inwards."""

    thickness_mm: float
    young_MPa: float
    poisson: float = 0.48  # silicone: nearly incompressible


@dataclass(frozen=True)
class PadMaterial:
    """A gel or dome with markers, and the camera behind it."""

    layers: tuple[Layer, ...]  # from the skin inwards
    readout_mm: float  # depth of the markers, or of the pins' roots
    cell_mm: float = 1.25  # of its finite elements
    stiffness: float = 1.0  # factor on Young's modulus of every layer
    camera_mm: float = 30.0  # distance from the markers to the optical centre
    pin_mm: float = 0.0  # length of the pin that tilts with the skin; 0: markers are printed


@dataclass(frozen=True)
class TaxelMaterial:
    """An elastomer with magnets, and the Hall sensors on the board below."""

    layers: tuple[Layer, ...]
    readout_mm: float  # depth of the magnets
    hall_mm: float  # from a magnet at rest to its sensor
    magnet_mm: float  # diameter: a stiff body that moves as the gel around it on average
    cell_mm: float = 1.25
    stiffness: float = 1.0
    # field of a magnet at rest, so that strong grasps give the 5 to 10 thousand counts of real ones
    rest_counts: float = 26_000.0
    # raw x, y of real taxels at rest differ this much
    baseline_shear: tuple[int, int] = (15_500, 16_800)
    baseline_normal: tuple[int, int] = (36_000, 39_000)  # raw z of real taxels at rest


@dataclass(frozen=True)
class ForceTaxelMaterial:
    """An elastomer over taxels whose maker has turned their signal into newtons."""

    layers: tuple[Layer, ...]
    readout_mm: float  # depth of the taxels
    spread_mm: float  # standard deviation over which a point force on the skin reaches taxels
    count_N: float  # force on a taxel that is one count
    noise_counts: float = 0.15  # standard deviation before it is rounded
    cell_mm: float = 1.25
    stiffness: float = 1.0


Material = PadMaterial | TaxelMaterial | ForceTaxelMaterial
