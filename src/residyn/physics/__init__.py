"""What moves, what acts on it, and the names of its numbers: Eq. 1 in JAX alone."""
