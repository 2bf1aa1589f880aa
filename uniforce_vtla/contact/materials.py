"""Material numbers of each simulated pad, all of them physical.

Anchors: the paper's gels are 25×25×4 mm and reach 12 N at 1.0 to 1.1 mm (GelSight, uSkin) and 4.6 mm (TacTip); a
sphere on a bonded layer then needs E of .3 to 1 MPa. Real TacTips give 3.3 to 4.7 N/mm.
"""

from dataclasses import dataclass

from uniforce_vtla.contact.elastic import Gel, Layer
from uniforce_vtla.errors import SensorError, expected
from uniforce_vtla.sensors import SensorSpec, get_sensor


@dataclass(frozen=True)
class PadMaterial:
    """A gel or dome with markers, and the camera behind it."""

    layers: tuple[Layer, ...]  # from the skin inwards
    readout_mm: float  # depth of the markers, or of the pins' roots
    cell_mm: float = 1.25  # of its finite elements
    stiffness: float = 1.0  # factor on Young's modulus of every layer
    camera_mm: float = 30.0  # distance from the markers to the optical centre
    pin_mm: float = 0.0  # length of the pin that tilts with the skin; 0: markers are printed
    fisheye: float = 0.0  # relative shortening of image radius at the pad's rim


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
    baseline_shear: tuple[int, int] = (15_500, 16_800)  # raw x, y of real taxels at rest differ this much
    baseline_normal: tuple[int, int] = (36_000, 39_000)  # raw z likewise


MATERIALS: dict[str, PadMaterial | TaxelMaterial] = {
    "gelsight": PadMaterial(layers=(Layer(4.0, 0.5),), readout_mm=0.5),
    "tactip": PadMaterial(
        layers=(Layer(1.0, 0.4), Layer(14.0, 0.08, 0.3)),  # rubber skin over a soft filling that can flow aside
        readout_mm=1.0,
        cell_mm=2.5,
        camera_mm=45.0,
        pin_mm=2.0,
        fisheye=get_sensor("tactip").fisheye,
    ),
    "uskin": TaxelMaterial(layers=(Layer(5.0, 0.5, 0.42),), readout_mm=2.0, hall_mm=8.0, magnet_mm=4.0),
}


def gel_of(spec: SensorSpec, material: PadMaterial | TaxelMaterial) -> Gel:
    """Return the body that finite elements are solved for."""
    return Gel(spec.pad_size_mm, material.layers, material.readout_mm, spec.dome_radius_mm, material.cell_mm)


def get_material(sensor: str) -> PadMaterial | TaxelMaterial:
    """Return the material of ``sensor``; raise SensorError where nothing was simulated yet."""
    if sensor not in MATERIALS:
        do = "Add it to contact/materials.py."
        raise SensorError(expected("simulated sensor", " | ".join(MATERIALS), repr(sensor), do))
    return MATERIALS[sensor]
