"""Fit of a fleet together with the error that its references share, on sums over blocks."""
