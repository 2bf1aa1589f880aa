"""Comparison rows of the zero-shot force table: published encoders, supervised nets, a translator."""
