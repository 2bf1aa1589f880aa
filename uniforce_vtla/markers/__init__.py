"""Stage 2: raw signal → canonical marker image; reference capture; the one mirror."""

from uniforce_vtla.markers.canonicalizer import Canonicalizer
from uniforce_vtla.markers.mirror import to_canonical, to_finger_frame
from uniforce_vtla.markers.taxel_render import TaxelScales

__all__ = ["Canonicalizer", "TaxelScales", "to_canonical", "to_finger_frame"]
