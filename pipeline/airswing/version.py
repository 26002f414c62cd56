"""The version, which products, pages and the public package import."""

__version__ = "1.0.0"
