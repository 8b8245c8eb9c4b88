"""ROS's occupancy grids, read back by Pillow's and PyYAML's readers and by the server's rule."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from monoloc.io.ros_grid import GREY_FREE, GREY_OCCUPIED, GREY_UNKNOWN, write_ros_grid


@pytest.mark.parametrize("name", ["map", "a room's: map #1"])
def test_server_takes_every_cell_back_at_its_place(tmp_path: Path, name: str) -> None:
    grey = np.full((4, 3), GREY_UNKNOWN, dtype=np.uint8)
    grey[0, 0], grey[3, 2] = GREY_OCCUPIED, GREY_FREE
    write_ros_grid(tmp_path / f"{name}.yaml", grey, np.array([-1.5, 2.0]), 0.05)
    server = yaml.safe_load((tmp_path / f"{name}.yaml").read_text())
    picture = Image.open(tmp_path / server["image"])
    assert picture.size == (4, 3) and picture.mode == "L"
    occupancy = (255.0 - np.asarray(picture)) / 255.0
    is_occupied, is_free = occupancy > server["occupied_thresh"], occupancy < server["free_thresh"]
    # The picture's first row is the highest y.
    assert np.argwhere(is_occupied[::-1].T).tolist() == [[0, 0]]
    assert np.argwhere(is_free[::-1].T).tolist() == [[3, 2]]
    assert server["origin"] == [-1.5, 2.0, 0.0] and server["resolution"] == 0.05
    assert server["negate"] == 0 and server["mode"] == "trinary"


def test_name_that_breaks_the_line_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a\nb.yaml"
    with pytest.raises(Exception, match="plain characters"):
        write_ros_grid(path, np.zeros((2, 2), dtype=np.uint8), np.zeros(2), 0.1)
    assert not list(tmp_path.iterdir())
