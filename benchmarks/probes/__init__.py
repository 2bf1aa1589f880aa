"""Worth of a tokenizer: labelled sets, baselines, tables, figures, real recordings."""
