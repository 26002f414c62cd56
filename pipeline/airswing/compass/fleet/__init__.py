"""The fleet solved together, beside the error its references share, on sums over blocks."""
