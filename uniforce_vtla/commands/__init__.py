"""Stage: commands."""
