"""Scripts that make shipped data and the pictures of the documentation: ``python -m monoloc_lab.make.NAME``."""
