"""Eq. 1 integrated: fixed steps with dry friction as an event, or any solver of diffrax."""
