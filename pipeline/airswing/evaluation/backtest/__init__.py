"""Corrections learned on some reports and judged on others."""
