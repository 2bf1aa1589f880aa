"""Records equilibrium pairs: what two fingers see of one contact, kept only where it was slow and balanced."""
