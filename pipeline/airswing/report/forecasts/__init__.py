"""The page of forecasts corrected after the fact."""
