"""``monoloc map localizability`` on the bundle of a synthetic room."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from cli_helpers import json_of, outputs, refused
from monoloc.bundle import write_bundle
from monoloc.landmarks.landmark_map import Landmarks
from synthetic_room import bundle_with_landmarks_ahead

COMMAND = ("map", "localizability", "room.monoloc")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    bundle = bundle_with_landmarks_ahead()
    write_bundle(tmp_path / "room.monoloc", bundle)
    write_bundle(tmp_path / "bare.monoloc", replace(bundle, landmarks=Landmarks.none()))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_table_has_a_row_for_each_view(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    figures = json_of(capfd, *COMMAND, "--cell", "0.5", "--pitch", "-10", "--out", "where.csv")
    with (here / "where.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == figures["places"] * figures["directions"] and figures["written"] == "where.csv"
    shares = np.array([float(row["probability"]) for row in rows])
    assert shares.mean() == pytest.approx(figures["found_share"], abs=0.001)
    assert {row["heading_deg"] for row in rows} == {str(30 * number) for number in range(12)}
    assert figures["pitch_deg"] == pytest.approx(-10.0) and figures["cell_m"] == 0.5


def test_picture_shows_every_place(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    figures = json_of(capfd, *COMMAND, "--out", "where.png")
    image = cv2.imread("where.png")
    assert figures["written"] == "where.png" and image is not None
    assert len(np.unique(image.reshape(-1, 3)[::7] @ (1, 256, 65536))) > 50


def test_unknown_gravity_is_warned_of(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    bundle = bundle_with_landmarks_ahead()
    patch = replace(bundle.original, weights=np.ones(1), means=np.zeros((1, 3)), covariances=0.1 * np.eye(3)[None])
    unknown = replace(bundle, original=patch, adapted=patch)
    assert unknown.down is None
    write_bundle(here / "unknown.monoloc", unknown)
    _, error = outputs(capfd, "map", "localizability", "unknown.monoloc", "--cell", "0.5")
    assert "warning: unknown.monoloc: floor and walls do not show the direction of gravity" in error


@pytest.mark.parametrize(
    ("command", "names", "problem", "fix"),
    [
        ((*COMMAND, "--out", "a.pdf"), "--out", "ends in .pdf", "choose from .png, .csv"),
        ((*COMMAND, "--pitch", "95"), "--pitch", "is 95", "give degrees from -89 to 89"),
        ((*COMMAND, "--height", "nan"), "--height", "is nan", "metres"),
        ((*COMMAND, "--height", "7"), "--height", "is 7, where the map has nothing", "choose from -"),
        ((*COMMAND, "--height", "1.29"), "--height", "saw no free space", "give another height"),
        ((*COMMAND, "--cell", "0"), "--cell", "is 0.0", "up to 2"),
        (("map", "localizability", "bare.monoloc"), "bare.monoloc", "keeps no landmarks", "build it again"),
        (("map", "localizability", "no"), "no", "is not a bundle", "monoloc build"),
    ],
)
def test_what_cannot_be_predicted_is_refused(
    capfd: pytest.CaptureFixture[str], here: Path, command: tuple[str, ...], names: str, problem: str, fix: str
) -> None:
    refused(capfd, here, command, names, problem, fix)
