"""Stage 2: raw signal → canonical marker image; reference capture; the one mirror."""

from uniforce_vtla.markers.canonicalizer import Canonicalizer
from uniforce_vtla.markers.mirror import to_canonical, to_finger_frame
from uniforce_vtla.markers.taxel_render import TaxelScales

# version of the marker images; a policy is held to the one it was trained on
MARKER_IMAGES = 2

__all__ = ["MARKER_IMAGES", "Canonicalizer", "TaxelScales", "to_canonical", "to_finger_frame"]
