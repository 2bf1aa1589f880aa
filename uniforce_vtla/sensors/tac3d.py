"""Tac3D: a flat gel; its own program tracks 20×20 points and gives their displacements in 3D."""

from uniforce_vtla.sensors.layouts import rectangular
from uniforce_vtla.sensors.material import Layer, PadMaterial
from uniforce_vtla.sensors.spec import PointSignal, SensorSpec

TAC3D = SensorSpec(
    name="tac3d",
    points=PointSignal(place_mm=rectangular(rows=20, columns=20, pitch_mm=(1.0, 1.0))),
    raw_shape=(400, 3),
    layout_mm=rectangular(rows=10, columns=10, pitch_mm=(2.0, 2.0)),  # each between four points
    px_per_mm=(24.0, 24.0),  # a GelSight's
    marker_shape="disc",
    marker_size_mm=0.9,
    pad_size_mm=(25.0, 25.0),
    rated_depth_mm=1.5,
    material=PadMaterial(layers=(Layer(4.0, 0.5),), readout_mm=0.5),
    source="20×20 points at about 30 Hz: PyTac3D 3.3 (PyPI); "
    "pitch, noise, depth and material are assumed",
)
