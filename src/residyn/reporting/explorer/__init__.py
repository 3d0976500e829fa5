"""The explorer: one page on which effects are added by hand and the error falls, live or inside a
report."""
