"""Export of corrected winds to WRF's nudging, WRFDA, GSI and JEDI, and correction of forecasts."""
