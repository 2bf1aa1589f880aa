"""Stage: sensors."""
