"""A recording whose depth images stay in memory, since several stages of a build read each of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.io.recording import Recording, Selection, narrowed

_MOST_BYTES = 1 << 28


class KeptDepth(Selection):
    """All frames of a recording; depth images are kept, as read-only arrays, until they take 256 MB.

    Registering a depth image to the colour takes ten times as long as reading a colour image.
    """

    def __init__(self, recording: Recording) -> None:
        # Of a selection, its source: checks look for what was left out, and for the kind of recording.
        selection = narrowed(recording, np.arange(len(recording)))
        super().__init__(selection.source, selection.positions)
        self.poses = selection.poses
        self._kept: dict[int, NDArray[np.float32]] = {}
        self._free_bytes = _MOST_BYTES

    def depth(self, index: int) -> NDArray[np.float32]:
        if index in self._kept:
            return self._kept[index]
        depth = super().depth(index).view()
        if depth.nbytes <= self._free_bytes:
            depth.flags.writeable = False
            self._kept[index] = depth
            self._free_bytes -= depth.nbytes
        return depth
