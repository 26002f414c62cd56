"""Where a point lies on a model's grid, and what one model time is."""
