"""Sampling an action chunk: the fast sampler, its arithmetic, and CUDA graphs around it."""
