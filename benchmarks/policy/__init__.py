"""Cost of a chunk of the policy: latency, operations, memory, touch; random weights, no checkpoint."""
