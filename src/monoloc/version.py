"""The version of monoloc."""

__version__ = "0.1.0"
