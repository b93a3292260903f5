"""The version, in a module that can be imported without loading the package."""

__version__ = "0.1.0"
