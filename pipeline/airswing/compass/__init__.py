"""The compass: headings, screening, deviation fits, correction tables and their application."""
