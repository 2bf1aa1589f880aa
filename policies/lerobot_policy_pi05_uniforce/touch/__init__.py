"""Touch in a policy: the frozen tokenizer, force sensors, the network's input and force tokens."""
