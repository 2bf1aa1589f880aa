"""What a chunk of the policy costs: latency, operations, memory, touch; random weights, no checkpoint."""
