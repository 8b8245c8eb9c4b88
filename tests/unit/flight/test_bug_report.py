"""What a bug report says, and what it must not say."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from monoloc.files import json_text
from monoloc.flight.bug_report import bug_report
from monoloc.flight.flight_file import FlightFile
from monoloc.version import __version__
from synthetic_room import SMALL_CAMERA, room_bundle


def test_a_report_names_versions_and_settings_but_no_place() -> None:
    bundle = room_bundle(60)
    bundle = replace(bundle, provenance=bundle.provenance.model_copy(update={"recording": "janes kitchen"}))
    flight = FlightFile(
        room=Path("/home/jane/secret.monoloc"),
        source="rtsp://jane:secret@10.1.2.3/x",
        camera="/home/jane/cam.toml",
        mavlink="udpout:10.1.2.3:14540",
        out=Path("/home/jane/out.csv"),
        most_age_s=0.3,
    )
    text = json_text(bug_report(flight, [bundle], SMALL_CAMERA, {"level": "good", "rooms": {"janes room": 3}}))
    report = json.loads(text)
    assert report["monoloc"] == __version__ and report["level"] == "good"
    assert {"processor", "system", "Python"} <= report["machine"].keys()
    assert report["libraries"]["onnxruntime"][0].isdigit()
    assert (report["source"], report["link"]) == ("rtsp", "udpout")
    assert report["flight_settings"]["most_age_s"] == 0.3
    assert report["camera"]["width"] == SMALL_CAMERA.width
    assert [room["components"] for room in report["maps"]] == [60]
    for private in ("jane", "secret", "10.1.2.3", "cam.toml", "janes kitchen"):
        assert private not in text
