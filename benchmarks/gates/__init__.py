"""Does a level need touch?  Scripts that must fail without it, or pass with a little less."""
