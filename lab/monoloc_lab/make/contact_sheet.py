"""One picture of twelve views of rendered rooms in the three lights, for the documentation.

python -m monoloc_lab.make.contact_sheet --out docs/pictures/synth-contact-sheet.jpg
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from monoloc.camera import Camera
from monoloc.files import write_whole
from monoloc_lab.synth.layout import generate_room
from monoloc_lab.synth.light import LIGHTS
from monoloc_lab.synth.random_views import random_view, shows_a_room
from monoloc_lab.synth.render import Renderer, illuminance, mixed
from monoloc_lab.synth.sensor import SensorConfig, photograph, white_balance

ROOM_SEEDS, VIEWS_EACH, SAMPLES = (1, 2, 3, 4, 6, 9), 2, 32
CAMERA = Camera(200, 150, 150.0, 150.0, 99.5, 74.5)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    columns: list[np.ndarray] = []
    for seed in ROOM_SEEDS:
        room = generate_room(seed)
        renderer = Renderer(room, SAMPLES)
        lux = illuminance(renderer, room)
        rng = np.random.default_rng(seed)
        shown = 0
        while shown < VIEWS_EACH:
            picture = renderer.picture(CAMERA, random_view(room, rng), seed)
            if not shows_a_room(picture):
                continue
            shown += 1
            images = []
            for light in LIGHTS.values():
                lit, sensor = mixed(picture.light, light.factors(lux)), light.exposed(SensorConfig())
                images.append(photograph(lit, sensor, rng, white_balance(lit, sensor.adapted)))
            columns.append(np.vstack(images))
    half = len(columns) // 2
    sheet = np.vstack([np.hstack(columns[:half]), np.hstack(columns[half:])])
    write_whole(arguments.out, cv2.imencode(".jpg", sheet[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])[1].tobytes())


if __name__ == "__main__":
    main()
