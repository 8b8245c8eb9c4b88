"""Settings of the localizer."""

from __future__ import annotations

import pytest

from monoloc.fusion.bias_model import BiasModel
from monoloc.localizer_config import LocalizerConfig


def test_settings_are_checked() -> None:
    with pytest.raises(ValueError, match="particles"):
        LocalizerConfig(particles=1)
    with pytest.raises(ValueError, match="motion"):
        LocalizerConfig(motion="guess")


@pytest.mark.parametrize(("sd_m", "is_supported"), [(0.0, True), (0.49, True), (0.5, False)])
def test_relocalization_is_supported_where_its_error_is_that_of_a_known_position(
    sd_m: float, is_supported: bool
) -> None:
    config = LocalizerConfig(particle_bias=BiasModel(relocalization_sd_m=sd_m))
    assert config.supports_relocalization == is_supported
