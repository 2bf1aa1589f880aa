"""Training of the pair recorder's force readers in simulation, on many units."""

from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import torch

from uniforce_robots.pairs.finger_force import ASSETS, FingerForce, TouchField
from uniforce_vtla.contact import PRETRAIN, ContactOptions
from uniforce_vtla.contact.sampling import ForceRange, sample_loads, sample_objects
from uniforce_vtla.contact.simulator import draw_simulator, images_of
from uniforce_vtla.contracts import ContactState
from uniforce_vtla.tokenizer.weights import save_checkpoint

LIGHT_N = 0.7  # errors of lighter contacts count absolutely


@dataclass(frozen=True)
class ForceTraining:
    """How a reader is trained."""

    units: int = 40  # simulated units of the sensor
    contacts: int = 250  # per unit
    steps: int = 2500  # of AdamW
    batch: int = 256
    learning_rate: float = 3e-3
    weight_decay: float = 1e-2
    dropout: float = 0.05
    loads: ForceRange = field(
        default_factory=lambda: ForceRange(normal_N=13.0, shear_N=6.0, friction=0.8)
    )
    seed: int = 0  # of units, contacts and weights; no scored session uses it


def training_contacts(sensor: str, training: ForceTraining) -> tuple[np.ndarray, np.ndarray]:
    """Return fields (N, 192) and the forces (N, 3) the pads carried, of many simulated units."""
    rng = np.random.default_rng([training.seed, 5])
    fields, forces = [], []
    for _ in range(training.units):
        simulator = draw_simulator(rng, sensor, 1.0, ContactOptions())
        objects = sample_objects(rng, training.contacts, PRETRAIN)
        load, _ = sample_loads(rng, training.contacts, training.loads)
        contact = ContactState(objects.gap_mm, load, np.zeros(training.contacts, np.float32))
        read = TouchField(simulator.reference(), "left")
        fields.append(np.stack([read(image) for image in images_of(simulator, contact)]))
        forces.append(simulator.carried(contact)[0])
    return np.concatenate(fields), np.concatenate(forces).astype(np.float32)


def train_finger_force(
    fields: np.ndarray, forces: np.ndarray, training: ForceTraining
) -> FingerForce:
    """Return a reader fitted to relative error: a tenth matters as much of a light force."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(training.seed)
        model = FingerForce(training.dropout)
        model.mean.copy_(torch.from_numpy(fields.mean(axis=0)))
        model.spread.copy_(torch.from_numpy(fields.std(axis=0) + 0.05))
        _fit(model, torch.from_numpy(fields), torch.from_numpy(forces), training)
    return model.eval()


def _fit(model: FingerForce, x: torch.Tensor, y: torch.Tensor, training: ForceTraining) -> None:
    optimizer = torch.optim.AdamW(
        model.parameters(), lr=training.learning_rate, weight_decay=training.weight_decay
    )
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, training.learning_rate, training.steps
    )
    for _ in range(training.steps):
        rows = torch.randint(len(x), (training.batch,))
        error = (model(x[rows]) - y[rows]) / (y[rows].norm(dim=1, keepdim=True) + LIGHT_N)
        loss = error.square().sum(dim=1).add(1e-4).sqrt().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()


def save_finger_force(
    model: FingerForce, sensor: str, training: ForceTraining, folder: Path | None = None
) -> Path:
    """Write weights and facts to a folder for ``from_pretrained``; the package's by default."""
    facts = {"sensor": sensor, "training": asdict(training)}
    return save_checkpoint(folder or ASSETS / sensor, model, facts)
