"""The version, below all that states it: products, pages and the package's face."""

__version__ = "1.0.0"
