"""The deviation of every aircraft: sums, robust fit, fleet, acceptance."""
