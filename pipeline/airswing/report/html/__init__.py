"""The parts every page is made of: document, style, maps, files."""
