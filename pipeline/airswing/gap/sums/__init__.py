"""Sums over the reports, and the algebra on them."""
