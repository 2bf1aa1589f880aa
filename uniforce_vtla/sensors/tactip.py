"""TacTip: a soft dome with 127 pins seen through a fisheye."""

from uniforce_vtla.sensors.layouts import hexagonal
from uniforce_vtla.sensors.material import Layer, PadMaterial
from uniforce_vtla.sensors.spec import SensorSpec

TACTIP = SensorSpec(
    name="tactip",
    layout_mm=hexagonal(rings=6, pitch_mm=2.95),  # 127 pins inside a 40 mm disc
    px_per_mm=(12.0, 12.0),  # the 40 mm disc fills the 480 rows
    marker_shape="disc",
    marker_size_mm=1.2,
    pad_size_mm=(40.0, 40.0),
    fisheye=0.07,
    dome_radius_mm=41.5,
    rated_depth_mm=5.0,
    material=PadMaterial(
        # rubber skin over a soft filling that can flow aside
        layers=(Layer(1.0, 0.4), Layer(14.0, 0.08, 0.3)),
        readout_mm=1.0,
        cell_mm=2.5,
        camera_mm=45.0,
        pin_mm=2.0,
    ),
    source="UniForce paper, section IV-A (127 markers, R 41.5 mm, diameter 40 mm, 5 mm)",
)
