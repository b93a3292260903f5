"""The version, for every file to name without opening the package."""

__version__ = "0.1.0"
