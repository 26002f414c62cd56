"""A campaign of damaged input files of every kind the package reads."""
