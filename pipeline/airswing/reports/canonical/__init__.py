"""Canonical columns: their names, units, times and codes, cleaned and every repair counted."""
