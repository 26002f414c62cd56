"""What terms explain of weeks that had no part in them."""
