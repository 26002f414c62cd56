"""Sample archives with their known truth beside them."""
