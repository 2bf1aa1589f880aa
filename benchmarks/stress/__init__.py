"""Where a touch policy breaks: faults of worn sensors in physical doses, rolled out."""
