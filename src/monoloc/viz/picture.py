"""Shared parts of all figures: style, colours and atomic file writes."""

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

# Colours that colour-blind readers can distinguish (Okabe and Ito 2008).
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

_STYLE: Any = {  # from 3.11 on, matplotlib types its settings as a dict of literals
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
    "text.parse_math": False,  # names may contain $
}


@contextmanager
def picture(path: str | Path, width_in: float, height_in: float) -> Iterator[Figure]:
    """Context for a figure, which is written to the PNG ``path`` if the block ends without an error.

    This function imports matplotlib on demand. It avoids pyplot, which would keep all figures alive and select a
    backend for the whole process.

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
