"""What a diagnosis rests on, each with a check made on the archive at hand."""
