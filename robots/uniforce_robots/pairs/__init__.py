"""Record equilibrium pairs: two fingers' images of one contact, where it was slow and balanced."""
