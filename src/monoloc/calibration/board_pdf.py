"""The board as a PDF at true scale: squares as vector graphics, so that no printer driver resamples them."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from monoloc.calibration.board import MODULES, Board
from monoloc.errors import SettingError
from monoloc.files import write_whole

Paper = Literal["a4", "letter"]
PAPERS_MM: dict[Paper, tuple[float, float]] = {"a4": (297.0, 210.0), "letter": (279.4, 215.9)}  # lying

_MM = 72.0 / 25.4  # PDF's points
_MARGIN_MM = 5.0  # that printers leave free, and of white that the detector needs
_TEXT_MM = 3.2
_FOOT_MM = 2.0 * _TEXT_MM + 2.0  # below the pattern, for two lines


def write_board(path: Path, board: Board, paper: Paper) -> None:
    """Write the board on one page.

    Raises:
        SettingError: the board is larger than the paper.
        DataError: the file cannot be written.
    """
    width, height = PAPERS_MM[paper]
    board_width, board_height = board.size_mm
    most = min((width - 2 * _MARGIN_MM) / board_width, (height - 2 * _MARGIN_MM - _FOOT_MM) / board_height)
    if most < 1.0:
        problem = (
            f"of {board.square_mm:g} makes the board {board_width:g} x {board_height:g} mm, too large for {paper}"
        )
        raise SettingError("square_mm", problem, f"give at most {int(most * board.square_mm)} mm")
    left = (width - board_width) / 2.0
    bottom = _FOOT_MM + (height - _FOOT_MM - board_height) / 2.0
    scale = board.square_mm / MODULES
    black = board.modules()
    # One path for all rectangles: renderers draw no seams within a path.
    path_of_squares = " ".join(
        f"{_points(left + x * scale)} {_points(bottom + (len(black) - y - h) * scale)} "
        f"{_points(w * scale)} {_points(h * scale)} re"
        for x, y, w, h in rectangles(black)
    )
    texts = [
        f"monoloc calibrate: {board.name}. Print at 100 % (actual size), and glue it to something flat.",
        f"One square is {board.square_mm:g} mm. Measure several together, and give --square-mm what one of yours is.",
    ]
    lines = [
        f"BT /F1 {_points(_TEXT_MM)} Tf {_points(left)} "
        f"{_points(bottom - (number + 1.4) * _TEXT_MM)} Td ({text}) Tj ET"
        for number, text in enumerate(_escaped(text) for text in texts)
    ]
    write_whole(path, _document((width, height), "\n".join([f"0 g {path_of_squares} f", *lines]).encode("ascii")))


def rectangles(black: NDArray[np.bool_]) -> list[tuple[int, int, int, int]]:
    """Rectangles (x, y, width, height) that cover the black modules of an image (rows, columns), each once."""
    left = black.copy()
    found = []
    for y, x in np.argwhere(black).tolist():
        if not left[y, x]:
            continue
        width = int(np.argmin(np.append(left[y, x:], False)))
        height = int(np.argmin(np.append(left[y:, x : x + width].all(axis=1), False)))
        left[y : y + height, x : x + width] = False
        found.append((x, y, width, height))
    return found


def _points(length_mm: float) -> str:
    return f"{length_mm * _MM:.4f}"


def _escaped(text: str) -> str:
    return text.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")


def _document(size_mm: tuple[float, float], content: bytes) -> bytes:
    """A PDF of one page that the content stream draws, with Helvetica as /F1 (ISO 32000-1, 7.5)."""
    box = " ".join(_points(length) for length in (0.0, 0.0, *size_mm))
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [{box}] /Contents 4 0 R "
        "/Resources << /Font << /F1 5 0 R >> >> >>".encode(),
        b"<< /Length %d >>\nstream\n%b\nendstream" % (len(content), content),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    data, offsets = b"%PDF-1.4\n", []
    for number, body in enumerate(objects, start=1):
        offsets.append(len(data))
        data += b"%d 0 obj\n%b\nendobj\n" % (number, body)
    table = b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
    count = len(objects) + 1
    trailer = b"trailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (count, len(data))
    return data + b"xref\n0 %d\n0000000000 65535 f \n" % count + table + trailer
