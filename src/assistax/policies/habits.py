"""People with habits: one scripted person whose parameters say how they help, when, and what drives them away.

None of them learned with a robot, so that nothing about them is an agreement: they are partners to test with, and a
robot never needs to have met them.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from assistax.errors import choose
from assistax.human.preference import TOUCH
from assistax.policies.people import Muscles, Reflex, offer
from assistax.policies.player import Player, stack


@dataclass(frozen=True)
class Habit:
    """How a person behaves; the fields are the parameters of a member."""

    offers: float = 1.0  # how much of the movement that offers what is worked on they make, 0 to 1
    way: float = 0.0  # in which of the ways that there are in the task, see `people.Offer`
    follows: float = 0.0  # the force toward the tool, as a part of Reflex.pull; below 0: away from it
    keeps: float = 0.0  # how much of what keeps the posture of rest against a push they do, 0 to 1
    speed: float = 1.5  # rad/s, of the movement that offers
    delay: float = 0.0  # s, until they do anything
    work: float = 100.0  # s, after which they rest ...
    rest: float = 0.0  # s, ... for so long
    shy: float = 100.0  # m/s: from a tool that is faster than this, and near, they draw back
    near: float = 0.3  # m, what is near to them
    vigour: float = 1.0  # of their strength, what they use
    noise: float = 0.0  # of full action, uniform, afresh at every step
    shows: float = 0.0  # the force, as a part of Reflex.pull, away from a tool that presses harder than they like, and
    # toward one that touches them more softly than they like


HABITS = {
    "still": Habit(offers=0.0),
    "keeps_still": Habit(offers=0.0, keeps=1.0),
    "random": Habit(offers=0.0, noise=1.0),
    "offers": Habit(),
    "offers_slowly": Habit(speed=0.3),
    "offers_fast": Habit(speed=3.0),
    "offers_second_way": Habit(way=1.0),
    "offers_third_way": Habit(way=2.0),
    "offers_fourth_way": Habit(way=3.0),
    "hesitates": Habit(delay=1.5),
    "comes_late": Habit(delay=3.0),
    "rests": Habit(work=1.5, rest=0.7),
    "spares_strength": Habit(vigour=0.4),
    "shy": Habit(shy=0.25),
    "very_shy": Habit(shy=0.12, near=0.4),
    "follows": Habit(offers=0.0, follows=0.5),
    "offers_and_follows": Habit(follows=0.3),
    "restless": Habit(noise=0.3),
    "withdraws": Habit(offers=0.0, follows=-1.0),
    "shows": Habit(shows=0.25),
    "shows_second_way": Habit(shows=0.25, way=1.0),
    "shows_third_way": Habit(shows=0.25, way=2.0),
    "shows_fourth_way": Habit(shows=0.25, way=3.0),
}


ALSO = {"offer": "offers", "offer_slowly": "offers_slowly", "withdraw": "withdraws"}  # scripts that act like a habit

FEELING = 0.1  # s, over which a force is felt


class Habits:
    """The policy of all people with habits in one environment; a member's parameters are a Habit's fields."""

    privileged = True

    def __init__(self, env):
        self.env = env
        self._offer, self._reflex, self._muscles = offer(env), Reflex(env, 1.0), Muscles(env)
        self._size = env.action_sizes["human"]

    def initial_carry(self):
        return {"steps": jnp.int32(0), "felt": jnp.float32(0.0), "offer": self._offer.initial_carry()}

    def act(self, habit, carry, state, reset, key):
        steps = jnp.where(reset, 0, carry["steps"])
        seconds = steps * self.env.dt
        offered, own = self._offer.act({k: habit[k] for k in ("speed", "way")}, carry["offer"], state, reset, key)
        s = self.env.sensors(state.physics)
        limb, _, _ = self._reflex.limb(state.physics.qpos)
        fast = jnp.linalg.norm(s["tool_vel"]) > habit["shy"]
        afraid = fast & (jnp.linalg.norm(s["tool_pos"] - limb) < habit["near"])
        since = seconds - habit["delay"]
        awake = (since >= 0.0) & (since % (habit["work"] + habit["rest"]) < habit["work"])
        following = jnp.where(habit["follows"] == 0.0, 0.0, self._reflex.moving(state, habit["follows"]))
        kept = habit["keeps"] * self._muscles.toward(self._muscles.rest, state)
        helping = awake * habit["vigour"] * (habit["offers"] * offered + following + kept)
        noise = habit["noise"] * jax.random.uniform(key, (self._size,), minval=-1.0, maxval=1.0)
        felt = jnp.where(reset, 0.0, carry["felt"])
        felt += self.env.dt / FEELING * (jnp.linalg.norm(s["tool_force"]) - felt)
        least, most = state.person.preference.force
        missing = jnp.where(felt > most, -1.0, jnp.where((felt > TOUCH) & (felt < least), 1.0, 0.0))
        shown = jnp.where(missing == 0.0, 0.0, self._reflex.moving(state, habit["shows"] * missing))
        action = jnp.where(afraid, self._reflex.moving(state, -1.0), helping + shown) + noise
        return jnp.clip(action, -1.0, 1.0), {"steps": steps + 1, "felt": felt, "offer": own}


def person(env, names: tuple[str, ...] | str, by_person: bool = False) -> Player:
    """The person with a habit of HABITS, or a player with several of them as members."""
    names = (names,) if isinstance(names, str) else names
    chosen = [HABITS[choose("habit", name, HABITS)] for name in names]
    params = stack([{k: np.float32(v) for k, v in vars(habit).items()} for habit in chosen])
    return Player(Habits(env), params, len(names), by_person)
