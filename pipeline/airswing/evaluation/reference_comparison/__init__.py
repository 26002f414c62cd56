"""How the fits depend on the reference."""
