"""Recording and reading LeRobot datasets with touch."""
