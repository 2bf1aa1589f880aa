"""Does a level need touch?  Scripts that must fail without it, scripts that must pass with a little less of it."""
