"""Stand-ins of teleoperators' devices; no command needs them, the tests of their drivers do."""
