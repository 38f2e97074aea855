"""What makes a person's movements hard: tremor, weakness, a limited range of motion.

Each part is continuous, they combine freely, and they act on the joints that the person drives in
the task at hand. Paper: section "Agents", after Assistive Gym.
"""

from itertools import combinations

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax.errors import UsageError, choose
from assistax.human import spelling
from assistax.pytree import pytree

RANGES = {"tremor": (0.0, 1.0), "tremor_hz": (3.0, 7.0), "strength": (0.01, 1.0), "motion": (0.05, 1.0)}


@pytree
class Disability:
    """One person's, every field a scalar."""

    tremor: jax.Array  # amplitude as a fraction of full torque
    tremor_hz: jax.Array
    strength: jax.Array  # full torque as a fraction of a healthy person's
    motion: jax.Array  # how much of the way from the resting pose to either joint limit is left


def disability(tremor: float = 0.0, tremor_hz: float = 5.0, strength: float = 1.0, motion: float = 1.0) -> Disability:
    """A Disability from plain numbers, by default none at all; raises UsageError outside RANGES."""
    values = {"tremor": tremor, "tremor_hz": tremor_hz, "strength": strength, "motion": motion}
    for name, value in values.items():
        low, high = RANGES[name]
        if not low <= value <= high:
            raise UsageError(f"A disability's {name} must be in [{low:g}, {high:g}], not {value:g}.")
    return Disability(**{name: np.float32(value) for name, value in values.items()})  # ty: ignore[invalid-argument-type]


def vector(person: Disability) -> jax.Array:
    """[4] tremor, its frequency in Hz, strength and motion."""
    return jnp.stack([person.tremor, person.tremor_hz, person.strength, person.motion])


MAGNITUDES = {"tremor": {"tremor": 0.3}, "weakness": {"strength": 0.4}, "limited_range": {"motion": 0.6}}
DISABILITIES = {  # the seven standard settings: every non-empty subset of the three
    "+".join(names): {k: v for name in names for k, v in MAGNITUDES[name].items()}
    for size in (1, 2, 3)
    for names in combinations(MAGNITUDES, size)
}


def parse(text: str) -> Disability:
    """ "none", a standard setting ("tremor+weakness") or numbers ("strength=0.5 tremor=0.2")."""
    if "=" not in text:
        return disability(**{"none": {}, **DISABILITIES}[choose("disability", text, ["none", *DISABILITIES])])
    parts = spelling.read("disability", text, {name: ("a number", (1,)) for name in RANGES})
    return disability(**{name: value for name, (value,) in parts.items()})


def spell(person: Disability) -> str:
    """The text that `parse` reads as this person, as short as can be."""
    parts = {name: spelling.number(getattr(person, name)) for name in RANGES}
    healthy = {name: spelling.number(getattr(disability(), name)) for name in RANGES}
    parts = {name: value for name, value in parts.items() if value != healthy[name]}
    for name, setting in {"none": {}, **DISABILITIES}.items():
        if parts == {part: spelling.number(value) for part, value in setting.items()}:
            return name
    return " ".join(f"{name}={value}" for name, value in parts.items())


def tremor(person: Disability, phase: jax.Array, seconds: jax.Array) -> jax.Array:
    """Involuntary torque [n] of the driven joints, as fractions of full torque; zero on average.

    Args:
      phase: [n] rad, drawn once per episode.
      seconds: since the beginning of the episode.
    """
    return person.tremor * jnp.sin(2.0 * jnp.pi * person.tremor_hz * seconds + phase)


class Body:
    """Where in a model a disability shows: the motors and joint limits of the driven joints."""

    def __init__(self, model: mujoco.MjModel, driven: tuple[str, ...]):
        self._gain = jnp.asarray(model.actuator_gainprm, jnp.float32)
        self._range = jnp.asarray(model.jnt_range, jnp.float32)
        self._motors = np.array([model.actuator(name).id for name in driven])
        self._joints = np.array([model.joint(name).id for name in driven])
        start = model.key("start").qpos[model.jnt_qposadr[self._joints]]
        self._start = jnp.asarray(start, jnp.float32)[:, None]

    def overrides(self, person: Disability, weak_motors: bool) -> dict[str, jax.Array]:
        """The model fields of this person: joint ranges, the start pose inside, and motor gains if motors are weak."""
        limits = self._start + person.motion * (self._range[self._joints] - self._start)
        ranges = {"jnt_range": self._range.at[self._joints].set(limits)}
        if not weak_motors:
            return ranges
        return ranges | {"actuator_gainprm": self._gain.at[self._motors, 0].multiply(person.strength)}
