"""Soft actor-critic for teams: settings, replay, trainer."""

from assistax.learning.sac.config import SACConfig
from assistax.learning.sac.trainer import SAC, SACState, temperature_loss

__all__ = ["SAC", "SACConfig", "SACState", "temperature_loss"]
