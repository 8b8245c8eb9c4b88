"""The frame that every picture shares: style, colours, and a file written whole."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from monoloc.errors import MissingExtraError
from monoloc.files import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Okabe and Ito (2008): colours that colour-blind readers can tell apart.
BLUE, ORANGE, GREEN, YELLOW, VERMILION, PURPLE = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#F0E442",
    "#D55E00",
    "#CC79A7",
)
SKY = "#56B4E9"
INK, GREY = "#1A1A1A", "#7F7F7F"

_STYLE: Any = {  # matplotlib types its settings from 3.11 on, as a dict of literals
    "axes.titlesize": 11,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#666666",
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E8E8E8",
    "legend.fontsize": 9,
    "legend.frameon": False,
    "text.parse_math": False,  # a $ in a name is a $
}


@contextmanager
def picture(path: str | Path, width_in: float, height_in: float) -> Iterator[Figure]:
    """A figure to draw on, which becomes the PNG at ``path`` when the block ends without an error.

    matplotlib is imported here and not before. pyplot is left alone: it would keep every figure alive and
    choose a backend for the whole process.

    Raises:
        MissingExtraError: matplotlib is not installed.
        DataError: the file cannot be written.
    """
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError("plots", "report") from error

    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(width_in, height_in), layout="constrained", facecolor="white")
        yield figure
        content = io.BytesIO()
        figure.savefig(content, format="png", dpi=130)
        write_whole(Path(path), content.getvalue())
