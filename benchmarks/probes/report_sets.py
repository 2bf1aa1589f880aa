"""Frozen sets a tokenizer is reported on: sensors, how they are drawn, what heads learn from."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from tqdm import tqdm

from benchmarks.finite_elements.sets import FE_CONTACTS, FE_DEV, ElementSettings, draw_elements
from benchmarks.probes.hard_sets import (
    HETERO_HARD,
    HETERO_HARD_TRAINING,
    HardSettings,
    draw_hard,
    hetero_sensors,
)
from benchmarks.probes.labelled_set import (
    FROZEN,
    HEAD_TRAINING,
    SENSORS,
    LabelledSet,
    SetConfig,
    cached,
    draw_labelled,
)
from uniforce_vtla.contact.virtual import VirtualSensor, as_virtual
from uniforce_vtla.markers.registration import nominal_zoom

Sensors = dict[str, VirtualSensor]
Recipe = SetConfig | HardSettings | ElementSettings


@dataclass(frozen=True)
class ReportSet:
    """A frozen set and the set that heads are trained on."""

    frozen: Recipe  # of what is scored
    training: Recipe  # of what heads are trained on
    sources: Callable[[], Sensors]  # sensors heads are trained on, one head each
    targets: Callable[[], Sensors]  # sensors that are scored
    table: str  # file of the table, inside the results folder

    @property
    def name(self) -> str:
        return self.frozen.name

    @property
    def facts_file(self) -> str:
        """File that holds the recipe and hash, committed before training."""
        return f"{self.name}_set.json"

    def draw(self, recipe: Recipe, sensors: Sensors, side: int, folder: Path) -> dict:
        found = {}
        for name, sensor in tqdm(sensors.items(), desc=f"drawing {recipe.name}"):
            drawn = partial(draw, recipe, sensor, side)
            found[name] = cached(folder, recipe, name, side, drawn, nominal_zoom(sensor.spec))
        return found


def draw(recipe: Recipe, sensor: VirtualSensor, side: int) -> LabelledSet:
    """Return one sensor's sequences by the recipe's own way of drawing."""
    if isinstance(recipe, SetConfig):
        return draw_labelled(recipe, sensor.name, side)
    if isinstance(recipe, ElementSettings):
        return draw_elements(recipe, sensor, side)
    return draw_hard(recipe, sensor, side)


def _registry_sensors() -> Sensors:
    return {name: as_virtual(name) for name in SENSORS}


REPORT_SETS = {
    "zero_shot_v2": ReportSet(
        FROZEN, HEAD_TRAINING, _registry_sensors, _registry_sensors, "zero_shot_force.json"
    ),
    "hetero_hard_v2": ReportSet(
        HETERO_HARD,
        HETERO_HARD_TRAINING,
        hetero_sensors,
        hetero_sensors,
        "zero_shot_force_hard.json",
    ),
    # heads learn on the fast contact model, finite elements solved step by step are read
    "fe_dev_v1": ReportSet(
        FE_DEV, HEAD_TRAINING, _registry_sensors, _registry_sensors, "fe_dev.json"
    ),
    "fe_contacts_v1": ReportSet(
        FE_CONTACTS, HEAD_TRAINING, _registry_sensors, _registry_sensors, "fe_contacts.json"
    ),
}
