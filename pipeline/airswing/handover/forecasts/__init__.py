"""Forecasts corrected by the errors of the model on earlier days."""
