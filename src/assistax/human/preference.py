"""How a person prefers to be helped: how fast, how firmly, without being poked, without waste.

Paper: section "Preference Rewards" and appendix "Preference Reward System".
"""

import jax
import jax.numpy as jnp
import numpy as np

from assistax.errors import UsageError, choose
from assistax.human import spelling
from assistax.pytree import pytree

TOUCH = 0.1  # N, τ: a touch begins when the force rises through this
RANGES = {"speed": (0.0, 1.0), "force": (0.0, 100.0)}  # what can be wanted
PARTS: spelling.Parts = {
    "speed": ("a range LEAST:MOST", (2,)),
    "force": ("a range LEAST:MOST", (2,)),
    "weights": ("three or four numbers SPEED,FORCE,TOUCH,ACTION", (3, 4)),
}
UNITS = {"speed": "m/s", "force": "N"}
WEIGHTS = {"speed": (0.0, 1.0), "force": (0.0, 1.0), "touch": (-1.0, 0.0), "action": (0.0, 1.0)}
NARROWEST = {"speed": 0.02, "force": 0.5}  # m/s, N: the paper's Gaussian divides by the width
SIZE = 7  # of the observed vector


@pytree
class Preference:
    """One person's. The paper's sweep draws all of it."""

    speed: jax.Array  # [2] m/s, of the tool point: least and most
    force: jax.Array  # [2] N, of the tool on the person: least and most
    weights: jax.Array  # [4] of speed, force, touch (at most 0) and action efficiency


def preference(
    speed: tuple[float, ...] = (0.06, 0.14),
    force: tuple[float, ...] = (1.5, 3.5),
    weights: tuple[float, ...] = (0.3, 0.35, -0.03),
) -> Preference:
    """A Preference from plain numbers, by default the paper's; raises UsageError for an impossible one.

    Args:
      speed, force: (least, most) within RANGES and at least NARROWEST apart.
      weights: of speed, force, touch and, if there is a fourth, action efficiency, within WEIGHTS.
    """
    for name, (low, high) in {"speed": speed, "force": force}.items():
        least, most = RANGES[name]
        if not least <= low <= high - NARROWEST[name] + 1e-6 <= most:
            raise UsageError(
                f"A preferred {name} must be a range LEAST:MOST within [{least:g}, {most:g}] {UNITS[name]} and "
                f"at least {NARROWEST[name]} wide, not {low:g}:{high:g}."
            )
    weights = (*weights, 0.0)[:4]
    for (name, (least, most)), weight in zip(WEIGHTS.items(), weights, strict=True):
        if not least <= weight <= most:
            raise UsageError(f"A preference's weight of {name} must be in [{least:g}, {most:g}], not {weight:g}.")
    w_speed, w_force, _, w_action = weights
    if w_speed + w_force + w_action < 1e-3:
        raise UsageError(
            "A preference's weights of speed, force and action must not all be zero: they share the budget, "
            "and must add up to 0.001 or more."
        )
    return Preference(*(np.asarray(x, np.float32) for x in (speed, force, weights)))  # ty: ignore[invalid-argument-type]


def parse(text: str) -> Preference:
    """ "default" (the paper's) or numbers: "speed=0.05:0.09 force=1.2:2 weights=0.3,0.35,-0.03"."""
    if "=" not in text:
        choose("preference", text, ["default"])
        return preference()
    return preference(**spelling.read("preference", text, PARTS))


def spell(person: Preference) -> str:
    """The text that `parse` reads as this person."""
    speed, force = (":".join(map(spelling.number, x)) for x in (person.speed, person.force))
    weights = ",".join(map(spelling.number, person.weights))
    return f"speed={speed} force={force} weights={weights.removesuffix(',0')}"


def sample(key: jax.Array) -> Preference:
    """A draw of the paper's sweep, its ranges at least NARROWEST wide."""
    u = jax.random.uniform(key, (7,))

    def between(i, low, high):
        return low + (high - low) * u[i]

    slow, soft = between(0, 0.03, 0.08), between(2, 1.0, 2.0)
    fast, firm = between(1, slow + NARROWEST["speed"], 0.20), between(3, soft + NARROWEST["force"], 5.0)
    weights = jnp.stack([between(4, 0.1, 0.5), between(5, 0.1, 0.6), between(6, -0.1, -0.01), 0.0])
    return Preference(jnp.stack([slow, fast]), jnp.stack([soft, firm]), weights)


def vector(person: Preference) -> jax.Array:
    """What an agent sees of it [7]: v_min, v_max, f_min, f_max, w_speed, w_force, w_touch."""
    return jnp.concatenate([person.speed, person.force, person.weights[:3]])


def liking(x: jax.Array, wanted: jax.Array) -> jax.Array:
    """Pref(x; [x_min, x_max]): 1 inside the range, outside a Gaussian around its centre (wanted [2])."""
    centre, width = wanted.mean(), (wanted[1] - wanted[0]) / 2
    inside = (wanted[0] <= x) & (x <= wanted[1])
    return jnp.where(inside, 1.0, jnp.exp(-jnp.square(x - centre) / (2.0 * jnp.square(width))))


def reward_terms(
    person: Preference, speed, force, force_before, action, budget: float, helping=True
) -> dict[str, jax.Array]:
    """Named terms whose positive ones add up to `budget` at most, whatever the weights.

    Args:
      speed: m/s of the tool point. force, force_before: N on the person, now and a step ago.
      action: [n] of the robot; its efficiency is 1 − mean(action²).
      helping: bool; while it is false only touches count.
    """
    w_speed, w_force, w_touch, w_action = person.weights
    eta = budget / (w_speed + w_force + w_action)
    paid = eta if helping is True else jnp.where(helping, eta, 0.0)
    touch = (force_before < TOUCH) & (force >= TOUCH)
    return {
        "prefer_speed": paid * w_speed * liking(speed, person.speed),
        "prefer_force": paid * w_force * liking(force, person.force),
        "prefer_touch": eta * w_touch * touch,
        "prefer_action": paid * w_action * (1.0 - jnp.square(action).mean()),
    }


def describe(person: Preference) -> str:
    """In words."""
    (slow, fast), (soft, firm) = np.asarray(person.speed), np.asarray(person.force)
    w_speed, w_force, w_touch, _ = np.asarray(person.weights)
    speed = "slow" if fast < 0.1 else "fast" if slow > 0.06 else "neither slow nor fast"
    touch = "gentle" if firm < 2.5 else "firm" if soft > 1.6 else "neither soft nor hard"
    cares = "how fast" if w_speed > w_force else "how firm"
    poke = "minds being poked" if w_touch < -0.05 else "does not mind a new touch much"
    return (
        f"prefers it {speed}, {slow:.2f}–{fast:.2f} m/s, and {touch}, {soft:.1f}–{firm:.1f} N; "
        f"cares more about {cares} it is, and {poke}"
    )
