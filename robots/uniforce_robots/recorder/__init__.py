"""Demonstrations from a rig, real or simulated: observe, steer, act, store, and stop in order."""
