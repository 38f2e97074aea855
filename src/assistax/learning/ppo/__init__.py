"""Proximal policy optimisation for teams: settings, losses, trainer."""

from assistax.learning.ppo.config import PPOConfig
from assistax.learning.ppo.losses import adapted_rate, clip_networks, clipped_policy_loss, value_loss
from assistax.learning.ppo.trainer import PPO, TrainState

__all__ = ["PPO", "PPOConfig", "TrainState", "adapted_rate", "clip_networks", "clipped_policy_loss", "value_loss"]
