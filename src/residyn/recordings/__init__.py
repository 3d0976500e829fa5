"""What was measured: recordings, experiments, and the files they come from."""
