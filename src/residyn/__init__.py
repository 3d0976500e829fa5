"""residyn: fit a braked arm from its recordings, see where the model fails, and mend it."""

__version__ = "0.1.0"
