"""What is kept of one episode for a film of it."""

from dataclasses import dataclass, field, replace

import numpy as np


def nothing() -> np.ndarray:
    """No steps."""
    return np.zeros(0)


@dataclass(frozen=True)
class Filmed:
    """One episode, by control step. Without the forces bodies and target are all that a film shows."""

    task: str
    dt: float  # s from step to step
    qpos: np.ndarray  # [T, nq]
    marker: np.ndarray  # [T, 3] m, the target
    force: np.ndarray = field(default_factory=nothing)  # [T, 3] N, of the robot on the person
    metrics: dict[str, np.ndarray] = field(default_factory=dict)  # by name [T], so far: see Env.metrics
    # What is to be done to the skin: by body of the person the spots' places [n, 3] in m, in the body's frame, and how
    # all of them are at every step [T, spots]: tasks.base.TO_DO, DONE or NOTHING_TO_DO.
    spots: dict[str, np.ndarray] = field(default_factory=dict)
    spot_states: np.ndarray = field(default_factory=nothing)
    before: int = 0  # control steps of the episode that are not in it

    def first(self, steps: int) -> "Filmed":
        """Its beginning."""
        series = {name: getattr(self, name)[:steps] for name in ("qpos", "marker", "force", "spot_states")}
        return replace(self, **series, metrics={name: values[:steps] for name, values in self.metrics.items()})
