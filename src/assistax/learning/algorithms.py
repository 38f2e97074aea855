"""Which algorithms there are. Another one is a `Trainer` class, a dataclass of settings, and one row:

register_algorithm(Algorithm("reinforce", Reinforce, ReinforceConfig, group="reinforce"))
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from assistax.learning.ppo import PPO, PPOConfig
from assistax.learning.sac import SAC, SACConfig
from assistax.learning.trainer import Trainer
from assistax.registry import Registry


@dataclass(frozen=True)
class Algorithm:
    """One algorithm, as commands, configurations and tables know it."""

    name: str
    trainer: Callable[..., Trainer]  # see `learning.trainer.Trainer`
    config_type: Any  # frozen dataclass of its settings; their defaults serve where no preset has a row
    group: str  # its settings are GROUP.NAME in --set and config.json
    switches: Mapping[str, Any] = field(default_factory=dict)  # settings that make it this algorithm, not to be changed
    shares: bool = False  # whether several devices can share its environments, see assistax.devices


ALGORITHMS: Registry[Algorithm] = Registry("algorithm", lambda algorithm: algorithm.name, "assistax.algorithms")


def register_algorithm(algorithm: Algorithm) -> Algorithm:
    """Add an algorithm; raises UsageError if its name is taken."""
    return ALGORITHMS.register(algorithm)


for _name, _central in (("ippo", False), ("mappo", True)):
    register_algorithm(Algorithm(_name, PPO, PPOConfig, "ppo", {"central_critic": _central}, shares=True))
for _name, _joint in (("masac", True), ("isac", False)):
    register_algorithm(Algorithm(_name, SAC, SACConfig, "sac", {"joint_critics": _joint}))
