"""Forecasts corrected after the fact by what the model got wrong on the days before."""
