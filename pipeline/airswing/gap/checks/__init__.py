"""Checks of the assumptions of a diagnosis, each on the archive at hand."""
