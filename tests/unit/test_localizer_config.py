"""Settings of the localizer."""

from __future__ import annotations

import pytest

from monoloc.localizer_config import LocalizerConfig


def test_settings_are_checked() -> None:
    with pytest.raises(ValueError, match="particles"):
        LocalizerConfig(particles=1)
    with pytest.raises(ValueError, match="motion"):
        LocalizerConfig(motion="guess")
