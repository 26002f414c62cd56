"""Which effects are at work: the search over candidates."""
