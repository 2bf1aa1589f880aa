"""A gel of ours: 7 by 9 printed discs on a 20 mm pad."""

from uniforce_vtla.sensors.layouts import rectangular
from uniforce_vtla.sensors.material import Layer, PadMaterial
from uniforce_vtla.sensors.spec import SensorSpec

MYGEL = SensorSpec(
    name="mygel",
    layout_mm=rectangular(rows=7, columns=9, pitch_mm=(2.1, 2.1)),
    px_per_mm=(28.0, 28.0),
    marker_shape="disc",
    marker_size_mm=0.8,
    pad_size_mm=(20.0, 20.0),
    rated_depth_mm=1.5,
    material=PadMaterial(layers=(Layer(3.0, 0.4),), readout_mm=0.5),
    source="measured on our own sensor",
)
