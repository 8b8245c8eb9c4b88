"""Text from files and names, which may hold what commands a terminal, made fit to be printed."""

from __future__ import annotations

import re

# C0 without tab and newline, DEL, C1, lone surrogates, and what changes the direction of the text that follows.
_UNPRINTABLE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff\u200e\u200f\u2028-\u202e\u2066-\u2069]")


def printable(text: str) -> str:
    r"""The text with control characters as their escapes, such as ``\x1b``."""
    return _UNPRINTABLE.sub(lambda match: match[0].encode("unicode_escape", "surrogatepass").decode(), text)
