"""UniForce: a latent force space shared by tactile sensors of any kind."""

from uniforce_vtla.markers import Canonicalizer, to_finger_frame
from uniforce_vtla.sensors import list_sensors
from uniforce_vtla.tokenizer import ForceHead, Tokenizer

__all__ = ["Canonicalizer", "ForceHead", "Tokenizer", "list_sensors", "to_finger_frame"]
