"""Contact stage: one traction field, any sensor. Contact state → marker images, frames, counts."""

from uniforce_vtla.contact.indenters import PRETRAIN, SEEN, UNSEEN, flat_face_gap, gap_map, gap_maps
from uniforce_vtla.contact.pairs import PairBatch, PairSettings, equilibrium_pairs
from uniforce_vtla.contact.responses import ContactOptions
from uniforce_vtla.contact.sampling import PAPER_RANGE, ForceRange
from uniforce_vtla.contact.simulator import TactileSimulator, free_air
from uniforce_vtla.contact.units import UnitVariation
from uniforce_vtla.markers.mirror import mirrored

__all__ = [
    "PAPER_RANGE",
    "PRETRAIN",
    "SEEN",
    "UNSEEN",
    "ContactOptions",
    "ForceRange",
    "PairBatch",
    "PairSettings",
    "TactileSimulator",
    "UnitVariation",
    "equilibrium_pairs",
    "flat_face_gap",
    "free_air",
    "gap_map",
    "gap_maps",
    "mirrored",
]
