"""Where a touch policy breaks: faults of worn sensors in physical doses, screened by what is read, then rolled out."""
