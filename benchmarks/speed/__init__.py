"""Latencies and throughputs, each beside an anchor measured in the same run."""
