"""monoloc: where a drone is indoors, from one camera and a map of a few kilobytes."""

__version__ = "0.1.0"
