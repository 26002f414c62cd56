"""Whether the winds improved, and how far that depends on the reference."""
