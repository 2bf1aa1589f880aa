"""Cost of a chunk of the policy: latency, operations, memory; random weights, no checkpoint."""
