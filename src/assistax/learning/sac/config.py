"""The settings of SAC; the paper's and our values are in `presets`."""

from dataclasses import dataclass

from assistax.errors import UsageError, choose
from assistax.learning.networks import ACTIVATIONS
from assistax.settings import check_count

MOST_AT_ONCE = 2**24  # transitions in a gradient step: some 10 GB of them


@dataclass(frozen=True)
class SACConfig:
    """The defaults are where the paper is silent; presets and `--set sac.NAME=VALUE` change them."""

    joint_critics: bool = True  # critics see both agents (MASAC) instead of their own alone (ISAC)
    actor_learning_rate: float = 3e-4  # of Adam
    critic_learning_rate: float = 1e-3  # of Adam
    alpha_learning_rate: float = 3e-4  # of Adam, for the temperatures
    tau: float = 0.005  # share of the critics that moves into their targets at every update
    num_steps: int = 8  # control steps per environment and iteration
    updates: int = 32  # gradient steps per iteration
    batch_size: int = 512  # transitions per gradient step
    gamma: float = 0.99  # discount per control step
    buffer_size: int = 1_000_000  # transitions; about 0.5 GB, in memory and on the disk
    warmup: int = 5_000  # transitions played with uniformly random actions, before the policy plays
    initial_alpha: float = 1.0  # temperature: weight of the entropy beside the reward
    noise_correlation: float = 0.0  # of the exploration from one step to the next
    hidden: tuple[int, ...] = (128, 128)  # units by layer, of actors and critics
    activation: str = "relu"  # tanh, relu, ... of the hidden layers
    normalize_obs: bool = True  # by running mean and standard deviation
    stagger: bool = True  # start the environments at different times of their episodes

    def __post_init__(self):
        for name in ("num_steps", "updates", "batch_size", "buffer_size"):
            check_count(f"sac.{name}", getattr(self, name))
        if self.batch_size > MOST_AT_ONCE:
            raise UsageError(f"sac.batch_size must be at most {MOST_AT_ONCE}, not {self.batch_size}.")
        if not 0 <= self.warmup < 2**31:
            raise UsageError(f"sac.warmup must be 0 or more and below 2^31, not {self.warmup}.")
        for name in ("actor_learning_rate", "critic_learning_rate", "alpha_learning_rate", "initial_alpha"):
            if getattr(self, name) <= 0:
                raise UsageError(f"sac.{name} must be above 0, not {getattr(self, name)}.")
        if not 0 < self.tau <= 1:
            raise UsageError(f"sac.tau must be in (0, 1], not {self.tau}.")
        if not 0 <= self.gamma <= 1:
            raise UsageError(f"sac.gamma must be in [0, 1], not {self.gamma}.")
        if not 0 <= self.noise_correlation < 1:
            raise UsageError(f"sac.noise_correlation must be in [0, 1), not {self.noise_correlation}.")
        if not self.hidden or not all(0 < size < 2**31 for size in self.hidden):
            raise UsageError(f"sac.hidden must be the sizes of one layer or more, not {self.hidden}.")
        choose("activation", self.activation, ACTIVATIONS)
