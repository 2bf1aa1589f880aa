"""Comparison rows of the zero-shot force table: published encoders, twins of their objectives, supervised nets."""
