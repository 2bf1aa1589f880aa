"""Stage: contact."""
