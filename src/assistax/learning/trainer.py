"""What a trainer is: the page that every algorithm fills in.

The training loop knows nothing else of an algorithm. It jits the functions below and, over seeds, vmaps them,
writes their state into checkpoints, and plays with `policy` and `policy_params`.
"""

from collections.abc import Mapping
from typing import Any, Protocol

import jax

from assistax.policies import Policy

TrainerState = Any
"""A pytree of arrays that holds everything a run needs to continue exactly, random keys included.

Two fields are read from outside, by name and without the others, when a checkpoint is played: `params` and
`normalizer`. `policy_params` must need no more of a state than these.
"""


class Trainer(Protocol):
    """One algorithm on one environment; holds settings and no state.

    It is made by `Trainer(env, settings, num_envs, total_iterations, partners)`: an environment with the interface of
    `assistax.env.Env`, the settings of the algorithm, how many environments are stepped side by side, the length of the
    run in iterations, and by agent the frozen partners.
    """

    learners: tuple[str, ...]
    """The agents that learn."""
    steps_per_iteration: int
    """Environment steps, over all environments, that one `collect` plays."""

    def init(self, key: jax.Array, tuned: Mapping[str, jax.Array] | None = None) -> TrainerState:
        """A fresh state; `tuned` are settings by name that stand in for those of the configuration."""
        ...

    def collect(self, state: TrainerState) -> tuple[TrainerState, dict[str, Any]]:
        """Play one iteration: the state, and a batch with the entry "log" of `learning.log.iteration_log`."""
        ...

    def improve(self, state: TrainerState, batch: dict[str, Any]) -> tuple[TrainerState, dict[str, Any]]:
        """Learn from it: the state, and by learner numbers to write down."""
        ...

    def policy(self, deterministic: bool = True) -> Policy:
        """How every learner acts, with its `policy_params`."""
        ...

    def policy_params(self, state: TrainerState) -> dict[str, Any]:
        """By learner, the parameters for `policy`."""
        ...
