"""Covariance of the wind residual along flights, and whitening by it."""
