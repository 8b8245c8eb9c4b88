"""Messages as the other side of a wire sees them."""

from __future__ import annotations

from typing import Any

import numpy as np

from monoloc.camera import Camera
from monoloc.depth.predictor import DepthPrediction
from monoloc.flight.flight_loop import FlightStep
from monoloc.geometry import FloatArray
from monoloc.likelihood.scan import EMPTY_SCAN
from monoloc.live.frame_source import LiveFrame
from monoloc.mavlink.messages import COMPONENT, dialect
from monoloc.particle_filter.estimate import Estimate
from monoloc.relocalization.state_machine import Mode
from monoloc.step import Step
from monoloc.supervision.state import Reason, State

CAMERA = Camera(40, 30, 30.0, 30.0, 19.5, 14.5)
BLACK = np.zeros((30, 40, 3), dtype=np.uint8)


def over_the_wire(message: Any) -> Any:
    """The message as another program decodes it from its bytes."""
    sender = dialect().MAVLink(None, srcSystem=1, srcComponent=COMPONENT)
    receiver = dialect().MAVLink(None)
    (decoded,) = receiver.parse_buffer(message.pack(sender))
    return decoded


class Wire:
    """A sink that keeps what the other side decodes."""

    def __init__(self) -> None:
        self.received: list[Any] = []

    def send(self, message: Any) -> None:
        self.received.append(over_the_wire(message))

    def of(self, kind: str) -> list[Any]:
        return [message for message in self.received if message.get_type() == kind]


def step_at(
    pose: FloatArray,
    state: State = "tracking",
    reasons: frozenset[Reason] = frozenset(),
    probability_far: float = 0.01,
    restarted: bool = False,
    covariance: FloatArray | None = None,
    depth_m: float = 2.0,
) -> Step:
    """A localizer's result, of a camera that sees a wall at a depth."""
    estimate = Estimate(pose, np.eye(6) * 1e-4 if covariance is None else covariance, 0.0)
    depth = DepthPrediction(np.full((30, 40), depth_m, dtype=np.float32), CAMERA)
    mode = Mode.SEARCHING if state == "lost" else Mode.TRACKING
    return Step(
        estimate=estimate,
        state=state,
        reasons=reasons,
        probability_far=probability_far,
        restarted=restarted,
        particle_estimate=estimate,
        mean_log_likelihood=1.0,
        landmark_pose=None,
        mode=mode,
        motion=None,
        depth=depth,
        scan=EMPTY_SCAN,
        changed_region=None,
    )


def result_at(captured_s: float, step: Step, age_s: float = 0.05) -> FlightStep:
    """A result that was known ``age_s`` after capture."""
    return FlightStep(LiveFrame(BLACK, captured_s, 0), 0.05, None, step, captured_s + age_s)
