"""Attacks on the robot's guards, on stored files and on the command line; one JSON, ``docs/results/trust.json``."""
