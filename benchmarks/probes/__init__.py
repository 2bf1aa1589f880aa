"""Stage: probes. What a tokenizer is worth: labelled sets, baselines, tables, figures, real recordings."""
