"""Real recordings as stored: what the tokenizer reads, beside what needs no training."""
