"""A fleet in the air: routes, instruments and their faults, and what the units report."""
