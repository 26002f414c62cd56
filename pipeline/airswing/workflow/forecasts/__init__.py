"""The job of correcting forecasts after the fact."""
