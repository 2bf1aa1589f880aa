"""Attacks on the robot's guards and on stored files; one JSON, ``docs/results/trust.json``."""
