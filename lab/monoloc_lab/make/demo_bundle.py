"""Build the bundle of the rendered living room that ``monoloc demo`` flies with, some minutes with PyTorch.

python -m monoloc_lab.make.demo_bundle
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rich.text import Text

from monoloc.adapt.settings import Tune
from monoloc.builder.build_config import BuildConfig
from monoloc.builder.pipeline import build_bundle
from monoloc.bundle import Bundle, read_bundle, write_bundle
from monoloc.cli.common import open_source, stderr
from monoloc.config import override
from monoloc.progress import ConsoleProgress
from monoloc_lab.rooms import BUILD, BUNDLE

_SEED = 0


@dataclass(frozen=True)
class RoomBuild:
    """What a room's bundles are built from, adapted or not.

    Attributes:
        adapt: settings of the adaptation; the rendered room takes fewer steps than the default, to be faster.
    """

    source: str
    frames: str
    network: str
    adapt: dict[str, object]

    def write(self, path: Path, adapted: bool, seed: int) -> Bundle:
        """Build the bundle, write it, and read it."""
        tune: Tune = "all" if adapted else "none"
        stderr.print(Text.assemble(("build", "bold"), f" {path.name} (--tune {tune})"))
        adapt = {**self.adapt, "tune": tune, "map_transform": adapted}
        config = override(BuildConfig(), adapt=adapt, landmarks=adapted)
        recording = open_source(self.source, self.frames)
        bundle, _ = build_bundle(recording, config, seed, ConsoleProgress(stderr), network=self.network)
        write_bundle(path, bundle)
        return read_bundle(path)  # its map is rounded, so this is the bundle that remains


LIVING = RoomBuild(f"folder:{BUILD}", "::2", "one-third-0.35", {"steps": 200, "synthesised_views": 300})
"""The rendered living room. ``make demo-bundle`` builds the shipped bundle with it."""


def main() -> None:
    LIVING.write(BUNDLE, adapted=True, seed=_SEED)


if __name__ == "__main__":
    main()
