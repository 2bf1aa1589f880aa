"""PaXini PX-6AX GEN3, finger pad IP-M2324-Core: 68 taxels of three forces in steps of 0.1 N."""

import numpy as np

from uniforce_vtla.sensors.material import ForceTaxelMaterial, Layer
from uniforce_vtla.sensors.spec import SensorSpec, TaxelSignal

_RIM = (-0.17, 4.60, 8.58, 13.36, 17.33, 22.11)
_OUTER = (1.60, 5.64, 9.01, 13.04, 16.41, 20.45)
_NEXT = (1.91, 5.82, 9.08, 12.99, 16.24, 20.15)
_INNER = (2.07, 5.91, 9.11, 12.96, 16.16, 20.00)
_LOWER = (-0.57,)
_UPPER = (22.60,)
_MIDDLE = (-0.57, 2.11, 5.94, 9.12, 12.95, 16.13, 19.96, 22.60)
_COLUMNS_mm = (  # x of each, then y from the lower edge upwards, in the order of the SDK
    (-11.89, _RIM),
    (-8.79, _OUTER),
    (-8.71, _LOWER),
    (-8.69, _UPPER),
    (-5.89, _NEXT),
    (-5.81, _LOWER),
    (-5.79, _UPPER),
    (-2.90, _LOWER),
    (-2.95, _INNER),
    (-2.90, _UPPER),
    (0.0, _MIDDLE),
    (2.90, _LOWER),
    (2.95, _INNER),
    (2.90, _UPPER),
    (5.81, _LOWER),
    (5.79, _UPPER),
    (5.89, _NEXT),
    (8.71, _LOWER),
    (8.69, _UPPER),
    (8.79, _OUTER),
    (11.89, _RIM),
)
_CENTRE_mm = 11.01  # y of the middle

PAXINI = SensorSpec(
    name="paxini",
    # worth and spread: chosen in simulation so that newtons look like a uSkin's (own_sensor.md)
    taxels=TaxelSignal(
        pitch_mm=(2.95, 3.2), worth=(160.0, 260.0, 480.0), spread_mm=2.5, tared=True
    ),
    raw_shape=(68, 3),
    layout_mm=np.array(
        [(x, _CENTRE_mm - y) for x, column in _COLUMNS_mm for y in column], np.float32
    ),
    px_per_mm=(20.8, 17.0),  # a uSkin's
    marker_shape="disc",
    marker_size_mm=0.32,
    pad_size_mm=(24.0, 23.2),
    rated_depth_mm=1.5,
    rate_hz=91.0,
    # all but count_N is assumed, for the maker publishes none: a uSkin's elastomer
    material=ForceTaxelMaterial(
        layers=(Layer(5.0, 0.5, 0.42),), readout_mm=2.0, spread_mm=2.0, count_N=0.1
    ),
    source="places, 0.1 N and 91 Hz: paxini-sdk 0.1.0 (PyPI, MIT), data/pxsr_stdip03a_points.json "
    "and README; drawn flat, though rim taxels lie 3.3 mm lower; depth and material are assumed",
)
