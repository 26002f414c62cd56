"""Simulated reports, effects in files, and removal of known effects."""
