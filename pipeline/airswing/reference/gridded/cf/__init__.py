"""What a Dataset means: its axes, times, levels, winds and grid, by CF attributes and MetPy."""
