"""Which effects are at work: the search over candidates, and what shows in no mean."""
