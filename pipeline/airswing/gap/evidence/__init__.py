"""How much the data speak for a candidate, for which aircraft, from which day on, and where."""
