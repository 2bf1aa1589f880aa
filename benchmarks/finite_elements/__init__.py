"""A second opinion on contact: friction solved step by step on finite elements. Scoring only, never for choosing."""
