"""pi0.5 with force tokens."""
