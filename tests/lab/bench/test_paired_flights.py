"""Flights before and after a change: ratios build by build, what counts as decided, and refusals."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from cli_helpers import json_of, outputs
from monoloc_lab.bench.paired_flights import compared, paired
from refusals import refuses_data

FLIGHT: dict[str, Any] = {
    "bundle": "b0/room.monoloc", "digest": "b0", "source": "kitchen", "selection": "300:400", "start": "truth",
    "seed": 0, "frames": 100, "unseen_frames": 100, "states": {"tracking": 90, "map-changed": 5, "lost": 5},
    "ate_rmse_m": 0.04, "ate_median_m": 0.03, "rot_median_deg": 1.0,
    "silent_frames_30cm": 0, "silent_frames_3_5_sigma": 2,
}  # fmt: skip


def write(folder: Path, name: str, **changed: object) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(json.dumps(FLIGHT | changed))
    return folder / name


@pytest.fixture
def before(tmp_path: Path) -> Path:
    """Three builds whose bundles have one name, two flights each; the errors of a build differ by a factor."""
    for build in range(3):
        for seed in range(2):
            errors = {"ate_rmse_m": 0.04 * (1 + build) + 0.01 * seed}
            bundle = {"bundle": f"b{build}/room.monoloc", "digest": f"b{build}"}
            write(tmp_path / "before", f"{build}-{seed}.json", **bundle, seed=seed, **errors)
    return tmp_path / "before"


def changed_by(before: Path, *factors: float) -> Path:
    """The same flights, with the errors of each build multiplied."""
    after = before.with_name("after")
    for file in before.iterdir():
        flight = json.loads(file.read_text())
        factor = factors[int(file.name[0])]
        other = {"bundle": "other/a.monoloc", "digest": "a"}
        write(after, file.name, **flight | other | {"ate_rmse_m": factor * flight["ate_rmse_m"]})
    return after


@pytest.mark.parametrize(
    ("factors", "verdict"),
    [((0.5, 0.8, 0.9), "better"), ((1.1, 1.2, 1.3), "worse"), ((0.5, 0.6, 1.1), "undecided")],
)
def test_ratio_is_that_of_builds_and_decides_where_none_contradicts(
    before: Path, factors: tuple[float, ...], verdict: str
) -> None:
    (found,) = compared(paired(before, changed_by(before, *factors))[0])
    assert (found.builds, found.flights, found.frames, found.same_flights) == (3, 6, 600, 0)
    ratio = found.rmse_m.ratio
    assert ratio is not None
    assert (ratio.low, ratio.median, ratio.high) == pytest.approx(sorted(factors))
    assert found.rmse_m.verdict == verdict
    assert found.rmse_m.before.median == pytest.approx(0.085)  # of 0.045, 0.085 and 0.125, each of two flights
    assert found.median_m.verdict == "undecided"  # the same in all
    assert (found.vouched_for.before, found.silent_3_5_sigma.after) == (570, 12)


def test_two_builds_decide_nothing_and_other_frames_are_compared_apart(before: Path) -> None:
    for name in ("2-0.json", "2-1.json"):
        write(before, name, selection="1:300")
    few, one = compared(paired(before, changed_by(before, 0.1, 0.1, 0.1))[0])
    assert (few.selection, few.builds, one.selection, one.builds) == ("1:300", 1, "300:400", 2)
    assert few.rmse_m.verdict == one.rmse_m.verdict == "undecided"


def test_frames_that_built_the_bundle_do_not_count(before: Path) -> None:
    unseen = {"unseen_frames": 60, "unseen_ate_rmse_m": 0.02, "unseen_silent_frames_3_5_sigma": 1}
    write(before, "0-0.json", **unseen)
    flight = paired(before, before)[0][0].before
    assert (flight.ate_rmse_m, flight.silent_frames_3_5_sigma) == (0.02, 1)
    assert flight.frames == 100  # as the states


def test_the_same_flights_are_named_whatever_their_bundle_is_called(before: Path) -> None:
    (found,) = compared(paired(before, changed_by(before, 1.0, 1.0, 0.9))[0])
    assert found.same_flights == 4


def test_an_error_of_nothing_has_no_ratio(before: Path) -> None:
    write(before, "0-0.json", rot_median_deg=0.0)
    write(before, "0-1.json", rot_median_deg=0.0, seed=1)
    (found,) = compared(paired(before, before)[0])
    assert found.rotation_deg.ratio is None and found.rotation_deg.verdict == "undecided"


def test_what_cannot_be_compared_is_refused(before: Path) -> None:
    after, fix = before.with_name("after"), "monoloc localize BUNDLE SOURCE --json"
    after.mkdir()
    refuses_data(lambda: paired(before, after), after, "has no .json files", fix)
    write(after, "other.json")
    refuses_data(lambda: paired(before, after), after, "has no file of a name that is in", "one name")
    file = write(after, "0-0.json", seed=3)
    refuses_data(lambda: paired(before, after), file, "seed: is 3, in .* it is 0", "from the same start")
    write(after, "0-0.json", selection="::2")
    refuses_data(lambda: paired(before, after), file, "selection: is ::2", "over the same frames")
    write(after, "0-0.json", unseen_frames=75, unseen_ate_rmse_m=0.03)
    refuses_data(lambda: paired(before, after), file, "unseen_frames: is 75, in .* it is 100", "that built neither")
    file.write_text(json.dumps({"digest": "00", "frames": 3}))
    refuses_data(lambda: paired(before, after), file, "its recording has no poses", "recordings with poses")
    file.write_text("[]")
    refuses_data(lambda: paired(before, after), file, "", fix)
    file.write_text("no JSON")
    refuses_data(lambda: paired(before, after), file, "is no JSON", fix)
    file.unlink()
    file.mkdir()
    refuses_data(lambda: paired(before, after), file, "cannot be read", fix)


def test_command_compares_and_names_what_it_leaves_out(before: Path, capfd: pytest.CaptureFixture[str]) -> None:
    after = changed_by(before, 0.5, 0.8, 0.9)
    write(after, "more.json")
    found = json_of(capfd, "bench", "compare", str(before), str(after))
    assert found["comparisons"][0]["rmse_m"]["verdict"] == "better"
    printed, said = outputs(capfd, "bench", "compare", str(before), str(after))
    assert "0.80 (0.50 to 0.90) better" in printed and "6 flights of 3 builds" in printed
    assert "only one folder has more.json; left out" in said
