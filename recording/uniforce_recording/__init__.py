"""Demonstrations from a rig, real or simulated: observe, steer, act, store, thirty times a second, and stop in order."""
