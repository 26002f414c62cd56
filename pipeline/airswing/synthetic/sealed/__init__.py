"""Archives of the blind check: drawn, written, and their truth sealed."""
