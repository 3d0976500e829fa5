"""What residyn asks of JAX and of the machine: settings, the cache of compiled programs, cores."""
