"""The printed board: its size on paper, and that what is drawn is the board."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
import pypdf
import pytest

from monoloc.calibration.board import Board
from monoloc.calibration.board_pdf import PAPERS_MM, Paper, rectangles, write_board

MM = 72.0 / 25.4


@pytest.mark.parametrize("paper", PAPERS_MM)
@pytest.mark.parametrize("square_mm", [30.0, 24.5])
def test_page_shows_the_board_at_true_scale(tmp_path: Path, paper: Paper, square_mm: float) -> None:
    board, path = Board(square_mm), tmp_path / "board.pdf"
    write_board(path, board, paper)
    (page,) = pypdf.PdfReader(BytesIO(path.read_bytes()), strict=True).pages
    width, height = PAPERS_MM[paper]
    assert (float(page.mediabox.width), float(page.mediabox.height)) == pytest.approx(
        (width * MM, height * MM), abs=1e-3
    )
    assert f"One square is {square_mm:g} mm." in page.extract_text()
    contents = page.get_contents()
    assert contents is not None
    words = contents.get_data().decode().split()
    boxes = np.array([words[at - 4 : at] for at, word in enumerate(words) if word == "re"], dtype=float) / MM
    # The squares drawn, at ten pixels to the millimetre and upside down as in a PDF, are the board's own image.
    corner, size = boxes[:, :2].min(axis=0), np.array(board.size_mm)
    assert np.all(corner >= 5.0) and np.all(corner + size <= [width - 5.0, height - 5.0])
    drawn = np.zeros(np.round(10.0 * size).astype(int)[::-1], dtype=bool)
    for left, bottom, across, up in np.round(10.0 * (boxes - [*corner, 0.0, 0.0])).astype(int):
        drawn[bottom : bottom + up, left : left + across] = True
    expected = board.charuco.generateImage(drawn.shape[::-1], marginSize=0, borderBits=1) < 128
    assert np.mean(drawn[::-1] != expected) < 0.01  # rounded borders of modules


def test_rectangles_cover_black_once() -> None:
    black = np.random.default_rng(0).random((20, 30)) < 0.6
    covered = np.zeros(black.shape, dtype=int)
    for x, y, width, height in rectangles(black):
        covered[y : y + height, x : x + width] += 1
    np.testing.assert_array_equal(covered, black)
