"""The page of a run, one file a section or figure group."""
