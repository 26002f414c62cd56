"""The version, below all that states it: products, pages and the package's face."""

__version__ = "0.1.0"
