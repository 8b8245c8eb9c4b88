"""Build the bundle of the rendered living room that ``monoloc demo`` flies with, some minutes with PyTorch.

python -m monoloc_lab.make.demo_bundle
"""

from __future__ import annotations

from monoloc_lab.cli.demo import LIVING
from monoloc_lab.rooms import BUNDLE

_SEED = 0


def main() -> None:
    LIVING.write(BUNDLE, adapted=True, seed=_SEED)


if __name__ == "__main__":
    main()
