"""Trials of the recorder against stand-ins: whole sessions, kill -9, faults, overhead."""
