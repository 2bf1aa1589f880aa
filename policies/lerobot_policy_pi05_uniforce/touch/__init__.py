"""Touch in a policy: inputs, the frozen tokenizer, force tokens, and what only training or a control needs."""
