"""What is said: parameters, sets, gap.json."""
