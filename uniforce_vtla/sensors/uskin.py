"""XELA uSkin patch: 4×4 magnetic taxels of three axes each."""

from uniforce_vtla.sensors.layouts import rectangular
from uniforce_vtla.sensors.material import Layer, TaxelMaterial
from uniforce_vtla.sensors.spec import SensorSpec, TaxelSignal

PITCH_mm = (24.6 / 4, 22.6 / 4)

USKIN = SensorSpec(
    name="uskin",
    taxels=TaxelSignal(pitch_mm=PITCH_mm),
    raw_shape=(16, 3),
    # the first row is the lowest
    layout_mm=rectangular(rows=4, columns=4, pitch_mm=(PITCH_mm[0], -PITCH_mm[1])),
    # one taxel pitch = 128 × 96 px of the canonical image
    px_per_mm=(128.0 / PITCH_mm[0], 96.0 / PITCH_mm[1]),
    marker_shape="disc",
    marker_size_mm=0.67,  # 13.9 px at rest: the canonical renderer's smallest disc
    pad_size_mm=(24.6, 22.6),
    rated_depth_mm=1.5,
    rate_hz=500.0,
    material=TaxelMaterial(
        layers=(Layer(5.0, 0.5, 0.42),), readout_mm=2.0, hall_mm=8.0, magnet_mm=4.0
    ),
    source="UniForce paper, section IV-A (4×4 taxels, 24.6×22.6×5 mm, 500 Hz)",
)
