"""Settings files and options: what is wrong with them, in one line that names the field."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from monoloc.builder.build_config import BuildConfig
from monoloc.config import load_settings, override
from monoloc.errors import SettingError
from monoloc.localizer_config import LocalizerConfig
from refusals import refuses, refuses_data


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("compnents = 5\n", "compnents: is unknown, the nearest is components"),
        ("[adapt]\nstep = 5\n", "adapt.step: is unknown, the nearest is steps"),
        ("voxel_m = -1\n", "voxel_m: must be greater than or equal to 0.001"),
        ('components = "many"\n', "components: must be a valid whole number, or must be 'bic'"),
        ('[adapt]\ntune = "most"\n', "adapt.tune: must be 'none', 'last', 'decoder' or 'all'"),
        ("[localizer.likelihood]\noutlier_share = 1.0\n", "localizer.likelihood.outlier_share: .*less than 1"),
        ("components 5\n", "is not valid TOML"),
        ("components = " + 5000 * "9", "is not valid TOML"),
        ("voxel_m = inf\n", "voxel_m: must be a finite number"),
        ("components = 1000000000\n", "components: .*less than or equal to 1000000"),
    ],
)
def test_invalid_settings_file_is_refused(tmp_path: Path, text: str, problem: str) -> None:
    path = tmp_path / "settings.toml"
    path.write_text(text)
    refuses_data(lambda: load_settings(path, BuildConfig), path, problem, "correct the (field|line) named")


def test_missing_settings_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "no.toml"
    refuses_data(lambda: load_settings(path, BuildConfig), path, "cannot be read", "give a TOML file")


@pytest.mark.parametrize(
    ("settings", "field", "value", "problem"),
    [
        (BuildConfig(), "components", "0", "greater than or equal to 1, or .*'bic'"),
        (BuildConfig(), "components", "forty", "valid whole number.*or .*'bic'"),
        (BuildConfig(), "adapt.lambda_kl", -1.0, "greater than or equal to 0"),
        (BuildConfig(), "adapt.lambda_kl", float("nan"), "a finite number"),
        (BuildConfig(), "adapt.lambda_kl", True, "is true or false, not a number"),
        (LocalizerConfig(), "particles", 3, "greater than or equal to 10"),
        (LocalizerConfig(), "scan_points", 3, "greater than or equal to 10"),
    ],
)
def test_value_out_of_range_is_refused(
    settings: BuildConfig | LocalizerConfig, field: str, value: object, problem: str
) -> None:
    outer, _, inner = field.partition(".")
    values = {outer: {inner: value} if inner else value}
    refuses(
        lambda: override(settings, **values), SettingError, f"^{re.escape(field)}: .*{problem}.*; correct its value$"
    )


def test_misspelt_field_is_refused_with_the_one_that_it_may_mean() -> None:
    refuses(
        lambda: override(LocalizerConfig(), particels=200),
        SettingError,
        "^particels: is unknown, the nearest is particles; correct its name$",
    )


def test_override_replaces_only_given_fields() -> None:
    changed = override(BuildConfig(components=25), components=None, adapt={"tune": "last", "lambda_kl": None})
    assert changed.components == 25 and changed.adapt.tune == "last"
    assert changed.adapt.lambda_kl == BuildConfig().adapt.lambda_kl
