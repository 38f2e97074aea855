"""Trained teams without JAX: plain NumPy, for real robots and other languages.

    team = assistax.load_team("scratch-v0")            # a team of the package, a team file or a run folder
    team.reset()                                       # at the beginning of an episode
    actions = team.act({"robot": obs_robot, "human": obs_human})

`team.save("team.npz")` writes arrays with plain names, `NumPyTeam.load("team.npz")` reads them. This file needs nothing
but NumPy, and can be copied to where it is used. What lies where in an observation says `env.obs_layout`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

CLIP = 10.0  # standard deviations, of what the networks see
_ACTIVATIONS = {
    "tanh": np.tanh,
    "relu": lambda x: np.maximum(x, 0.0),
    "swish": lambda x: x * _sigmoid(x),
}


def _sigmoid(x):
    return 0.5 * (1.0 + np.tanh(0.5 * x))


@dataclass
class NumPyPolicy:
    """One agent's trained policy, its mean action; float32 throughout, as it was trained."""

    activation: str
    squashed: bool  # SAC's: the first half of the last layer's output is the mean, through tanh
    mean: np.ndarray  # [obs] of what the networks see
    scale: np.ndarray  # [obs], 1 / standard deviation
    weights: list[np.ndarray]  # [in, out] of each layer; with memory the first feeds the gates [in, 3n]
    biases: list[np.ndarray]
    gru: tuple[np.ndarray, np.ndarray] | None = None  # [n, 3n] and [n], see learning.networks.gru_gates
    normalized: bool = True  # whether the networks see observations shifted, scaled and clipped, or as they are
    memory: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))

    def reset(self) -> None:
        """Forget, as at the beginning of an episode."""
        if self.gru is not None:
            self.memory = np.zeros(len(self.gru[1]), np.float32)

    def act(self, obs) -> np.ndarray:
        """The action [n] in [-1, 1] for an observation [m]."""
        x = np.asarray(obs, np.float32)
        if self.normalized:
            x = np.clip((x - self.mean) * self.scale, -CLIP, CLIP)
        weights, biases, activate = self.weights, self.biases, _ACTIVATIONS[self.activation]
        if self.gru is not None:
            x = self.memory = self._remember(x @ weights[0] + biases[0])
            weights, biases = weights[1:], biases[1:]
        for w, b in zip(weights[:-1], biases[:-1], strict=True):
            x = activate(x @ w + b)
        x = x @ weights[-1] + biases[-1]
        return np.tanh(x[: len(x) // 2]) if self.squashed else np.clip(x, -1.0, 1.0)

    def _remember(self, x):
        assert self.gru is not None
        w, b = self.gru
        n = len(b)
        recalled = self.memory @ w
        forget, update = np.split(_sigmoid(x[: 2 * n] + recalled[: 2 * n]), 2)
        new = np.tanh(x[2 * n :] + forget * (recalled[2 * n :] + b))
        return new + update * (self.memory - new)


class NumPyTeam:
    """The trained policies of a team, by agent."""

    def __init__(self, policies: Mapping[str, NumPyPolicy]):
        self.policies = dict(policies)
        self.reset()

    def reset(self) -> None:
        for policy in self.policies.values():
            policy.reset()

    def act(self, obs: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Actions by agent, of those whose observation is given."""
        return {agent: self.policies[agent].act(x) for agent, x in obs.items()}

    def save(self, path: str | Path) -> None:
        """One .npz file: "robot.weights.0", "robot.mean" and so on."""
        arrays = {}
        for agent, p in self.policies.items():
            arrays |= {f"{agent}.activation": np.array(p.activation), f"{agent}.squashed": np.array(p.squashed)}
            arrays |= {f"{agent}.normalized": np.array(p.normalized)}
            arrays |= {f"{agent}.mean": p.mean, f"{agent}.scale": p.scale}
            arrays |= {f"{agent}.weights.{i}": w for i, w in enumerate(p.weights)}
            arrays |= {f"{agent}.biases.{i}": b for i, b in enumerate(p.biases)}
            if p.gru is not None:
                arrays |= {f"{agent}.gru.weights": p.gru[0], f"{agent}.gru.bias": p.gru[1]}
        with open(path, "wb") as file:
            np.savez(file, **arrays)

    @classmethod
    def load(cls, path: str | Path) -> "NumPyTeam":
        """What `save` wrote."""
        with np.load(path, allow_pickle=False) as file:
            arrays = dict(file)
        policies = {}
        for agent in dict.fromkeys(name.split(".")[0] for name in arrays):
            own = {name.removeprefix(f"{agent}."): x for name, x in arrays.items() if name.startswith(f"{agent}.")}
            layers = range(sum(name.startswith("weights.") for name in own))
            gru = (own["gru.weights"], own["gru.bias"]) if "gru.bias" in own else None
            policies[agent] = NumPyPolicy(
                str(own["activation"]),
                bool(own["squashed"]),
                own["mean"],
                own["scale"],
                [own[f"weights.{i}"] for i in layers],
                [own[f"biases.{i}"] for i in layers],
                gru,
                bool(own["normalized"]),
            )
        return cls(policies)
