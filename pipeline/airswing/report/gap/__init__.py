"""The page of a gap diagnosis: words, where, which, how far."""
