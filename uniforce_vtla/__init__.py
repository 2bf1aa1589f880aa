"""UniForce: a latent force space shared by tactile sensors of any kind."""
