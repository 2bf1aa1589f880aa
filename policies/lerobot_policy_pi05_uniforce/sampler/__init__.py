"""Sampling an action chunk: the fast sampler, its prefix and its arithmetic."""
