"""Noise of the wind residual along flights, and the whitening by it."""
