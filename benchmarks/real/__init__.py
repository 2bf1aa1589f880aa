"""Real recordings as their authors store them: what the tokenizer reads there, beside what needs no training."""
