"""Material numbers of each simulated pad. Plausible, not identified: chosen so that the paper's ranges come out.

Anchors: rated depth near 12 N on a full flat face (UniForce paper, section IV-A); e-folding radii of marker
motion 1.4 / 3.5 mm (FOTS); uSkin counts of real grasps (95 % below 4,200, strongest 5–10 thousand).
"""

from dataclasses import dataclass

from uniforce_vtla.errors import SensorError, expected


@dataclass(frozen=True)
class PadMaterial:
    """How a pad and what is seen of it answer to load."""

    rated_force_N: float = 12.0  # on a flat face, reaches the rated depth; the paper's normal range
    # how much stiffer per area a small contact is: a bonded layer carries load beyond the footprint
    footprint_exponent: float = 0.8
    skin_blur_mm: float = 1.2  # standard deviation with which the skin bridges the object's relief
    dilation_per_N: float = 0.09  # outward motion per mm of distance and newton
    dilation_radius_mm: float = 2.0  # its e-folding radius; FOTS 1.4 mm at half our marker pitch of 2.5 mm
    drag_mm_per_N: float = 0.25  # motion along a point shear of 1 N
    # e-folding radii of its local (FOTS 3.5 mm) and wide part: a sheared layer moves as a whole
    drag_radii_mm: tuple[float, float] = (3.5, 9.0)
    drag_local_share: float = 0.6
    stretch_limit_mm: float = 2.2  # motion at which the material has stiffened by √2
    area_per_N: float = 0.03  # relative growth of a marker's area per newton close by
    area_radius_mm: float = 3.0  # e-folding radius of that growth
    camera_mm: float = 30.0  # distance from the surface to the optical centre
    pin_mm: float = 0.0  # length of the pin that tilts with the skin; 0: markers lie on the surface
    fisheye: float = 0.0  # relative shortening of image radius at the pad's rim


@dataclass(frozen=True)
class TaxelMaterial:
    """How a magnetic taxel answers: Gaussian weight of traction around it, gains in counts per newton."""

    rated_force_N: float = 12.0
    footprint_exponent: float = 0.8
    reach_pitch: float = 0.6  # standard deviation of a taxel's sensitivity, in pitches
    normal_counts_per_N: float = 700.0  # 12 N on one taxel ≈ 8,400 counts: a real strong grasp
    # real |dx|/dz at the 99th percentile ≈ .2, light boxes far from slipping
    shear_counts_per_N: float = 500.0
    cross_talk: float = 0.15  # counts of x, y per count of z and reach of offset
    baseline_shear: tuple[int, int] = (15_500, 16_800)  # raw x, y of real taxels at rest differ this much
    baseline_normal: tuple[int, int] = (36_000, 39_000)  # raw z likewise


MATERIALS: dict[str, PadMaterial | TaxelMaterial] = {
    "gelsight": PadMaterial(),
    "tactip": PadMaterial(
        skin_blur_mm=2.5,
        dilation_per_N=0.03,
        dilation_radius_mm=4.0,
        drag_mm_per_N=0.55,  # hollow dome: softer than a bonded gel
        drag_radii_mm=(5.0, 12.0),
        stretch_limit_mm=5.0,
        area_per_N=0.01,
        area_radius_mm=5.0,
        camera_mm=45.0,
        pin_mm=2.0,
        fisheye=0.07,
    ),
    "uskin": TaxelMaterial(),
}


def get_material(sensor: str) -> PadMaterial | TaxelMaterial:
    """Return the material of ``sensor``; raise SensorError where nothing was simulated yet."""
    if sensor not in MATERIALS:
        do = "Add it to contact/materials.py."
        raise SensorError(expected("simulated sensor", " | ".join(MATERIALS), repr(sensor), do))
    return MATERIALS[sensor]
