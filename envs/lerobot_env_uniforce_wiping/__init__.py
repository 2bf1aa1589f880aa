"""The wiping scene."""
