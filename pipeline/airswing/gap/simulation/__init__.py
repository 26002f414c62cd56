"""The forward simulation of the reports, and the effects it is given."""
