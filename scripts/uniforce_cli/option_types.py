"""Types of options that several commands share; what they allow is in ``uniforce_vtla/options.py``."""

from __future__ import annotations

from typing import Annotated, Literal

from uniforce_vtla.options import Names
from uniforce_vtla.sensors import list_sensors

Verify = Literal["full", "quick", "off"]  # how files are checked: whole, sizes and samples, not at all
# the environment's, which takes seconds to import; a test compares
Level = Literal["easy", "paper", "touch", "hard"]
Sensor = Annotated[str, Names(list_sensors())]
Sensors = Annotated[str, Names(list_sensors(), many=True)]
