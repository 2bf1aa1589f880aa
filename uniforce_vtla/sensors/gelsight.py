"""GelSight 2017, in-house: flat gel with 80 square markers seen by a Logitech C270."""

from uniforce_vtla.sensors.layouts import rectangular
from uniforce_vtla.sensors.material import Layer, PadMaterial
from uniforce_vtla.sensors.spec import SensorSpec

GELSIGHT = SensorSpec(
    name="gelsight",
    layout_mm=rectangular(rows=8, columns=10, pitch_mm=(2.5, 2.5)),  # 80 squares on a 25 mm pad
    px_per_mm=(24.0, 24.0),  # 10 columns fill 540 of 640 px
    marker_shape="square",
    marker_size_mm=0.9,
    pad_size_mm=(25.0, 25.0),
    rated_depth_mm=1.5,
    material=PadMaterial(layers=(Layer(4.0, 0.5),), readout_mm=0.5),
    source="UniForce paper, section IV-A (80 squares, 25×25×4 mm, 1.5 mm)",
)
