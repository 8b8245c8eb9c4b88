"""The source paper's figures and table, and what goes beyond them: one file each."""
