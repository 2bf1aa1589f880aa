"""Sampling an action chunk: the fast sampler, its arithmetic on a CPU, and CUDA graphs around it."""
