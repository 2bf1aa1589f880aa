"""A second opinion on contact: friction on finite elements.  For scoring, never for choosing."""
