"""Numpy kernels: plain arrays in, plain arrays out, SI units and radians, no labels, no files."""
