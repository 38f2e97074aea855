"""The settings of PPO; the paper's and our values are in `presets`."""

import math
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp

from assistax.errors import UsageError, choose
from assistax.learning.networks import ACTIVATIONS
from assistax.settings import check_count

QUIETER = 0.75  # of a run, after which exploration has come down to final_log_std, unless exploration_steps says when


@dataclass(frozen=True)
class PPOConfig:
    """The defaults are where the paper is silent; presets and `--set ppo.NAME=VALUE` change them."""

    central_critic: bool = False  # critics see the global state (MAPPO) instead of the agent's own observation (IPPO)
    critic_knows_partner: bool = False  # critics, which no policy sees, are told which member of a partner plays
    recurrent: bool = False  # in actors a GRU of hidden[0] units in place of the first layer
    partner_code: int = 0  # numbers in which a model of the partners (LIAM), a GRU, tells the actor of them; 0: none
    share_parameters: bool = False  # one actor and one critic for all learners, with who plays as an input
    learning_rate: float = 3e-4  # of Adam, for actors and critics
    anneal_learning_rate: bool = False  # lower it linearly to zero over the run
    desired_kl: float = 0.0  # per iteration; actors that move over twice as far learn slower, see adapted_rate; 0: off
    num_steps: int = 64  # control steps per environment and iteration
    update_epochs: int = 8  # passes over what an iteration has played
    num_minibatches: int = 16  # gradient steps per pass
    clip_eps: float = 0.2  # how far the probability ratio may be from 1 before its gradient stops
    clip_value: bool = False  # clip value changes like the policy's
    entropy_coef: float = 1e-3  # weight of the entropy bonus in the loss
    value_coef: float = 0.5  # weight of the critics' errors in the loss
    gamma: float = 0.99  # discount per control step
    gae_lambda: float = 0.95  # of generalised advantage estimation
    max_grad_norm: float = 0.5  # the longest gradient, per network
    hidden: tuple[int, ...] = (128, 128)  # units by layer, of actors and critics
    activation: str = "tanh"  # tanh, relu, ... of the hidden layers
    initial_log_std: float = 0.0  # of the actors' noise, natural logarithm
    final_log_std: float | None = None  # what it is lowered to at least, evenly; None: free
    exploration_steps: int = 0  # environment steps after which it is that low, as long as it takes to find the way;
    # 0: after QUIETER of the run, so that a shorter run explores less
    cost_limit: float | None = None  # on an episode's undiscounted cost, on average; None: no limit
    multiplier_gains: tuple[float, ...] = (
        1.0,
        0.05,
        0.0,
    )  # P, I and D of its multiplier, see constraint.updated
    noise_correlation: float = 0.0  # of the exploration from step to step; begins anew with episode and rollout
    correlated_steps: int = 0  # environment steps after which noise_correlation is 0, as long runs need; 0: never
    teachers: tuple[str, ...] = ()  # "human=offer": scripted policies that learners imitate at first, see teacher.py
    teaching_coef: float = 1.0  # of the imitation loss, which takes the place of their policies' at first
    teaching_steps: int = 2_000_000  # environment steps in which reward takes over, evenly
    teaching_floor: float = 0.0  # of teaching's weight, which falls from 1: to the end, against forgetting; 0: none
    teaching_kl: float = 0.0  # beside desired_kl at first, evenly less as reward takes over; 0: no limit while taught
    normalize_obs: bool = True  # by running mean and standard deviation
    stagger: bool = True  # start the environments at different times of their episodes

    def __post_init__(self):
        for name in ("num_steps", "update_epochs", "num_minibatches"):
            check_count(f"ppo.{name}", getattr(self, name))
        for name in ("learning_rate", "clip_eps", "max_grad_norm"):
            if getattr(self, name) <= 0:
                raise UsageError(f"ppo.{name} must be above 0, not {getattr(self, name)}.")
        for name in ("value_coef", "entropy_coef"):
            if getattr(self, name) < 0:
                raise UsageError(f"ppo.{name} must be 0 or more, not {getattr(self, name)}.")
        for name in ("gamma", "gae_lambda"):
            if not 0 <= getattr(self, name) <= 1:
                raise UsageError(f"ppo.{name} must be in [0, 1], not {getattr(self, name)}.")
        limit = 0.0 if self.cost_limit is None else self.cost_limit
        if isinstance(limit, bool) or not isinstance(limit, int | float) or not limit >= 0:
            raise UsageError(f"ppo.cost_limit must be a number of 0 or more, or None, not {self.cost_limit!r}.")
        if len(self.multiplier_gains) != 3 or not all(0 <= gain < math.inf for gain in self.multiplier_gains):
            raise UsageError(f"ppo.multiplier_gains must be three numbers of 0 or more, not {self.multiplier_gains}.")
        last = 0.0 if self.final_log_std is None else self.final_log_std
        if isinstance(last, bool) or not isinstance(last, int | float) or not math.isfinite(last):
            raise UsageError(f"ppo.final_log_std must be a finite number, or None, not {self.final_log_std!r}.")
        if not 0 <= self.noise_correlation < 1:
            raise UsageError(f"ppo.noise_correlation must be in [0, 1), not {self.noise_correlation}.")
        if self.correlated_steps < 0:
            raise UsageError(f"ppo.correlated_steps must be 0 (all of the run) or more, not {self.correlated_steps}.")
        if self.exploration_steps < 0:
            raise UsageError(
                f"ppo.exploration_steps must be 0 (a share of the run) or more, not {self.exploration_steps}."
            )
        if not 0 <= self.desired_kl < math.inf:
            raise UsageError(f"ppo.desired_kl must be 0 (none) or above, not {self.desired_kl}.")
        if self.teaching_coef < 0:
            raise UsageError(f"ppo.teaching_coef must be 0 or more, not {self.teaching_coef}.")
        check_count("ppo.teaching_steps", self.teaching_steps)
        if not 0 <= self.teaching_floor <= 1:
            raise UsageError(f"ppo.teaching_floor must be from 0 to 1, not {self.teaching_floor}.")
        if self.teaching_kl < 0:
            raise UsageError(f"ppo.teaching_kl must be 0 or more, not {self.teaching_kl}.")
        if self.partner_code < 0:
            raise UsageError(f"ppo.partner_code must be 0 (none) or more, not {self.partner_code}.")
        if self.partner_code and (self.recurrent or self.share_parameters):
            other = "ppo.recurrent" if self.recurrent else "ppo.share_parameters"
            raise UsageError(f"ppo.partner_code has a memory of its own, for each learner; leave out {other}.")
        if not all(0 < size < 2**31 for size in self.hidden) or (
            not self.hidden and (self.remembers or self.share_parameters)
        ):
            raise UsageError(f"ppo.hidden must be the sizes of one layer or more, not {self.hidden}.")
        choose("activation", self.activation, ACTIVATIONS)

    @property
    def remembers(self) -> bool:
        """Whether actors have a memory, a GRU of their own or of a model of their partners."""
        return self.recurrent or self.partner_code > 0

    @property
    def constrained(self) -> bool:
        """Whether cost has a limit."""
        return self.cost_limit is not None and self.cost_limit < math.inf


def most_log_std(config: Any, iterations: Any, steps_per_iteration: int, of: int) -> Any:
    """The most that `log_std` may be after so many iterations of a training of `of`, with a PPOConfig's settings."""
    until = config.exploration_steps / steps_per_iteration or QUIETER * of
    share = jnp.minimum(iterations / until, 1.0)
    return config.initial_log_std + share * (config.final_log_std - config.initial_log_std)
