"""The environment: a task, a scene and an engine as two pure functions, `reset` and `step`.

Written for one environment; batch it with `jax.vmap`, nested if need be:

    env = assistax.make("scratch")
    obs, state = jax.vmap(env.reset)(jax.random.split(key, 1024))
    obs, state, rewards, terminated, truncated, info = jax.vmap(env.step)(keys, state, actions)
"""

import dataclasses
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from assistax import scenes
from assistax.episode import Bookkeeping, Sums
from assistax.errors import UsageError, choose
from assistax.human import HumanConfig, HumanProfile, disability, expression, harm, preference
from assistax.motors import Motors
from assistax.physics import UNSTABLE, PhysicsState, make_engine
from assistax.physics.batching import map_where, whole_batch
from assistax.pytree import pytree
from assistax.scenes.geometry import norm
from assistax.senses import Blocks, Senses, joined
from assistax.settings import check_count, check_measures, with_settings
from assistax.spaces import Box
from assistax.tasks import task_spec
from assistax.tasks.base import Sensors, TaskState

AGENTS = ("robot", "human")
Obs = dict[str, jax.Array]


@dataclass(frozen=True)
class EnvConfig:
    """What all tasks share."""

    episode_length: int = 1000  # control steps; 8 s
    substeps: int = 4  # physics steps of 2 ms per control step
    control: str = "torque"  # with gravity compensation; or "position", servo targets: 0 where the arm starts
    torque_scale: float = 0.3  # full action, as a fraction of the Panda's torque limits
    reset_noise: float = 0.005  # rad and rad/s, uniform on every joint
    clock: float | None = None  # Hz, of the clock that the robot sees; 0: it sees none; None: the task's
    force_limit: float = 20.0  # N, above this the force on the person is counted as too high
    human: HumanConfig = field(default_factory=HumanConfig)  # who the person is
    num_threads: int = 0  # of the mujoco engine; 0: all cores
    contacts_per_env: int = 24  # buffer of the warp engine
    constraints_per_env: int = 96  # buffer of the warp engine

    def __post_init__(self):
        for name in ("episode_length", "substeps", "contacts_per_env", "constraints_per_env"):
            check_count(f"env.{name}", getattr(self, name))
        check_measures("env", self)
        if self.num_threads > 2**16:
            raise UsageError(f"env.num_threads must be from 0 (all cores) to 65536, not {self.num_threads}.")
        if not 0 < self.torque_scale <= 1:
            raise UsageError(f"env.torque_scale must be in (0, 1], not {self.torque_scale}.")
        if self.clock is not None and (isinstance(self.clock, bool) or not isinstance(self.clock, int | float)):
            raise UsageError(f"env.clock must be a number of Hz, or None for the task's own, not {self.clock!r}.")
        if self.clock and self.clock > (fastest := 250.0 / self.substeps):
            raise UsageError(
                f"env.clock must be {fastest:g} Hz or slower, half of the control rate, not {self.clock:g}."
            )
        choose("control mode", self.control, ["torque", "position"])


@pytree
class EnvState:
    """One environment between two steps."""

    physics: PhysicsState
    task: TaskState
    person: HumanProfile
    phase: jax.Array  # [human's actions] rad, of the tremor
    tool_force: jax.Array  # N, of the tool on the person in the step before
    t: jax.Array  # int32, control steps since the reset
    seed: jax.Array  # uint32 [2], what the next automatic reset draws with, beside the step's key
    harm: harm.HarmState | None  # to the person's body, where the scene measures it
    episode: Sums  # so far, see episode.py
    felt: Any = ()  # N, the force that shows in the person's face, if the robot sees it
    met: Any = ()  # int32, episodes that this person was here before, if people stay for more than one


class _Start(NamedTuple):
    """What a reset draws."""

    qpos: jax.Array
    qvel: jax.Array
    task: TaskState
    person: HumanProfile
    phase: jax.Array
    overrides: dict[str, jax.Array]
    seed: jax.Array


class Env:
    """A robot and a person with a task. Pure functions; hold no state."""

    agents = AGENTS
    num_agents = len(AGENTS)

    def __init__(self, task: str, engine: str, config: EnvConfig, task_config: Any = None):
        self.spec, self.config = task_spec(task), config
        self.name = self.spec.id
        scene = dataclasses.replace(self.spec.scene, control=config.control)
        self.robot = scene.arm
        self.model = model = scenes.build(scene, visuals=False).compile()
        self.engine = make_engine(
            engine,
            model,
            substeps=config.substeps,
            num_threads=config.num_threads,
            contacts_per_env=config.contacts_per_env,
            constraints_per_env=config.constraints_per_env,
        )
        if self.engine.name == "mjx" and scene.speed_limits:
            # MJX's implicit integration damps by brakes that are off, too: speeds are wrong by up to 1 rad/s.
            raise UsageError(f"The mjx engine cannot keep {self.name} to its joint speeds; take mujoco, warp or a -v0.")
        self.episode_length = config.episode_length
        self.dt = float(model.opt.timestep * config.substeps)  # s per control step
        self.task_config = task_config or self.spec.config
        check_measures("task_config", self.task_config)
        self.task = self.spec.task(self.task_config, model, self.dt)
        driven = scene.human_driven
        if config.human.preferring and not hasattr(self.task, "tool_speed"):
            raise UsageError(f"People with preferences need tool_speed of a task, which {self.name} does not have.")
        self._body = disability.Body(model, driven)
        self.motors = Motors(model, scene, config.human, config.torque_scale, self.spec.tremor_weakens)
        self.action_sizes = self.motors.sizes
        self.clock = self.spec.clock if config.clock is None else float(config.clock)  # Hz
        self.sensors = Senses(model, self.robot.joints, driven, config.human)
        key = model.key("start")
        movable = np.zeros(model.nq)
        movable[scenes.qpos_ids(model, (*scenes.HUMAN_JOINTS, *self.robot.joints))] = 1.0
        self._start, self._noise = jnp.asarray(key.qpos), jnp.asarray(config.reset_noise * movable)
        self._staying = config.human.redraw_every > 1
        self._books = Bookkeeping(self.dt, config.force_limit, config.human.preferring)
        self._draw_where, self._observe_where = whole_batch(self._draw_batch), whole_batch(self._observe_batch)
        self._layouts = self._measure_layouts()
        sizes = {who: max(place.stop for place in layout.values()) for who, layout in self._layouts.items()}
        self.observation_sizes = {agent: sizes[agent] for agent in AGENTS}
        self.global_size = sizes["global"]

    def __reduce__(self):
        """Copied and pickled as what it is made of."""
        return Env, (self.name, self.engine.name, self.config, self.task_config)

    # -- the two functions ---------------------------------------------------------------------

    def reset(
        self, key: jax.Array, elapsed: jax.Array | int = 0, person: jax.Array | None = None
    ) -> tuple[Obs, EnvState]:
        """Begin an episode: fresh targets, joints at rest with a little noise.

        With `elapsed` the time limit is that many steps nearer, so that the episodes of a batch need
        not all end together. `person` is the row of who it is in the list of people; None draws one.
        """
        start = self._draw(key, person)
        physics = self.engine.init(start.qpos, start.qvel, start.overrides)
        state = self._begin(physics, start, jnp.asarray(elapsed, jnp.int32), jnp.int32(0) if self._staying else ())
        return self._observe(state), state

    def step(self, key: jax.Array, state: EnvState, actions: Obs):
        """One control step (8 ms) with auto-reset.

        Args:
          key: what an automatic reset draws with, beside a seed that the state carries: the same key at every
            step gives fresh episodes, too.
          actions: "robot" [7] and "human" [2 or 3], each entry clipped to [-1, 1].

        Returns:
          obs: by agent; of the new episode where the old one ended.
          state: likewise.
          rewards: by agent, the same for both (the paper's shared reward).
          terminated: by agent and `"__all__"`; the task itself is over, or the physics failed or an action was not
            finite: such a step changes nothing and pays nothing, and info["fault"] is not 0.
          truncated: by agent and `"__all__"`; the time limit, bootstrap through it.
          info: "final_observation" by agent and "final_global_observation", true also where a reset
            followed; "reward_terms" by name; "metrics" of the episode up to and with this step;
            "robot_force" on the person in N; "cost", 0 or more, apart from the reward: see human.harm.cost, and in
            version 0 the force as a fraction of the limit, beyond 1; "fault" of the engine.
        """
        obs, end, rewards, terminated, truncated, info = self.step_env(key, state, actions)
        done = terminated["__all__"] | truncated["__all__"]
        met, before = (), ()
        if self._staying:
            met = (end.met + 1) % self.config.human.redraw_every
            before = end.person, met > 0
        start = self._draw_where(done, key, state.seed, *before)
        physics = self.engine.reinit(end.physics, done, start.qpos, start.qvel, start.overrides)
        kept = dataclasses.replace(end, physics=physics)
        state = jax.tree.map(partial(jnp.where, done), self._begin(physics, start, jnp.int32(0), met), kept)
        info["final_observation"] = obs
        info["final_global_observation"] = self.global_obs(end)
        first = self._observe_where(done, jax.lax.stop_gradient(state))  # depends on nothing that was done
        return jax.tree.map(partial(jnp.where, done), first, obs), state, rewards, terminated, truncated, info

    def step_env(self, key: jax.Array, state: EnvState, actions: Obs):
        """`step` without the auto-reset: the ended episode's own last observation and state.

        Nothing is drawn in a step; the key is there so that both have one signature.
        """
        del key
        actions, fault = self.motors.checked(actions)
        ctrl = self.motors.disturbed(actions, state.person, state.phase, state.t * self.dt)
        physics = self.engine.step(state.physics, ctrl)
        physics, broken = self._unbroken(physics, state.physics, fault)
        s = self.sensors(physics)
        task = self.task.advance(s, state.task)
        terms = self.task.reward_terms(s, task)
        over = self.task.terminated(task)
        if self.spec.rest_pays:
            left = jnp.maximum(self.config.episode_length - state.t - 1, 0)
            terms[self.spec.rest_pays] *= 1.0 + left * over
        preferred = self._preference_terms(s, state, task, actions)
        terms, preferred = (
            {name: jnp.where(broken, 0.0, x) for name, x in some.items()} for some in (terms, preferred)
        )
        terminated = over | broken
        force = norm(s["robot_force"])
        harmed, cost = self._harm(s, state, force)
        state = dataclasses.replace(
            state,
            physics=physics,
            task=task,
            tool_force=norm(s["tool_force"]),
            felt=expression.feel(state.felt, norm(s["tool_force"]), self.dt) if self.config.human.expressing else (),
            t=state.t + 1,
            harm=harmed,
            episode=self._books.add(state.episode, s, force, sum(terms.values()), sum(preferred.values()), cost),
        )
        terms |= preferred
        reward = sum(terms.values())
        truncated = (state.t >= self.config.episode_length) & ~terminated
        info = {
            "reward_terms": terms,
            "metrics": self.metrics(state),
            "robot_force": force,
            "cost": cost,
            "fault": physics.fault,
        }
        everyone = (*AGENTS, "__all__")
        return (
            self._observe(state),
            state,
            dict.fromkeys(AGENTS, reward),
            dict.fromkeys(everyone, terminated),
            dict.fromkeys(everyone, truncated),
            info,
        )

    def met_before(self, state: EnvState) -> jax.Array:
        """bool, whether the person of this episode was that of the episode before, see HumanConfig.redraw_every."""
        return state.met > 0 if self._staying else jnp.bool_(False)

    # -- what one can ask of it ----------------------------------------------------------------

    def obs_layout(self, agent: str) -> dict[str, slice]:
        """Where each named block lies in the observation of "robot", "human" or "global"."""
        return dict(self._layouts[choose("agent", agent, self._layouts)])

    def global_obs(self, state: EnvState) -> jax.Array:
        """Everything that either agent sees, once [global_size]: for centralised critics."""
        return joined(self._blocks(state))

    def observation_space(self, agent: str) -> Box:
        """What an agent observes: [observation_sizes[agent]], without bounds."""
        return Box((self.observation_sizes[choose("agent", agent, AGENTS)],))

    def action_space(self, agent: str) -> Box:
        """What an agent can do: [action_sizes[agent]], each entry in [-1, 1]."""
        return Box((self.action_sizes[choose("agent", agent, AGENTS)],), -1.0, 1.0)

    def metrics(self, state: EnvState) -> dict[str, jax.Array]:
        """Outcome of the episode so far; after its last step, of the whole episode.

        `success` (0 or 1), the task's own outcomes, `cost`, `peak_force` (N) and `seconds_over_force_limit`
        of the robot on the person, `work_robot` and `work_human` (J), `return` and `length` (steps);
        with preferences also `task_return` and `preference_return`, which add up to it. From version 1 on also
        `safe_success`, success without clamping or impact beyond the limits, and `human.harm.outcomes`.
        """
        success = self.task.success(state.task)
        harmed = {}
        if state.harm is not None:
            harmed["safe_success"] = (success & harm.safe(state.harm)).astype(jnp.float32)
            harmed |= harm.outcomes(state.harm)
        outcomes = self.task.outcomes(state.task) | harmed
        return {"success": success.astype(jnp.float32), **outcomes, **state.episode, "length": state.t}

    def markers(self, state: EnvState) -> jax.Array:
        """World position [3] of the task's target."""
        return self.task.markers(self.sensors(state.physics), state.task)

    def beat(self, state: EnvState) -> jax.Array:
        """Sine and cosine [2] of the phase of the robot's clock, which is 0 at t = 0."""
        phase = 2.0 * jnp.pi * self.clock * self.dt * state.t
        return jnp.stack([jnp.sin(phase), jnp.cos(phase)])

    # -- parts ---------------------------------------------------------------------------------

    def _draw(self, key, person: jax.Array | None = None, before: tuple = ()) -> _Start:
        """`before` is the person so far, and whether it stays."""
        task_key, person_key, phase_key, key = jax.random.split(key, 4)
        profile = self.config.human.draw(person_key, person)
        if before:
            profile = jax.tree.map(partial(jnp.where, before[1]), before[0], profile)
        overrides = (
            self._body.overrides(profile.disability, self.spec.tremor_weakens) if self.config.human.disabled else {}
        )
        noise = jax.random.uniform(key, (2, self.model.nq), minval=-1.0, maxval=1.0) * self._noise
        limits = overrides.get("jnt_range", jnp.asarray(self.model.jnt_range))
        if not (limited := np.asarray(self.model.jnt_limited, bool)).all():  # the range of a joint without is (0, 0)
            limits = jnp.where(limited[:, None], limits, np.array([-np.inf, np.inf], np.float32))
        qpos = jnp.clip(self._start + noise[0], limits[:, 0], limits[:, 1])
        phase = jax.random.uniform(phase_key, (self.action_sizes["human"],), maxval=2.0 * jnp.pi)
        seed = jax.random.bits(jax.random.fold_in(key, _SEED), (2,), jnp.uint32)
        return _Start(qpos, noise[1], self.task.reset(task_key), profile, phase, overrides, seed)

    def _draw_batch(self, done: jax.Array, keys: jax.Array, seeds: jax.Array, *before) -> _Start:
        """What a reset draws [n, ...] where an episode is done, zeros elsewhere: random bits are not free."""

        @jax.vmap
        def draw(key, seed, *before):
            return self._draw(jax.random.fold_in(jax.random.fold_in(key, seed[0]), seed[1]), None, before)

        blank = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(draw, keys, seeds, *before))
        return map_where(draw, done, blank, keys, seeds, *before)

    def _begin(self, physics: PhysicsState, start: _Start, t, met: Any = ()) -> EnvState:
        harmed = harm.begin() if self.spec.scene.regions else None
        sums, zero = self._books.start(), jnp.float32(0.0)
        felt = zero if self.config.human.expressing else ()
        return EnvState(physics, start.task, start.person, start.phase, zero, t, start.seed, harmed, sums, felt, met)

    @staticmethod
    def _unbroken(physics: PhysicsState, before: PhysicsState, fault) -> tuple[PhysicsState, jax.Array]:
        """The state after a step or, with its fault, the one before if that step was none; and whether so."""
        fault = physics.fault | fault
        broken = (fault & UNSTABLE) != 0
        kept = {name: jnp.where(broken, getattr(before, name), getattr(physics, name)) for name in MOVES}
        return dataclasses.replace(physics, **kept, fault=fault), broken

    def _preference_terms(self, s: Sensors, state: EnvState, task: TaskState, actions: Obs) -> dict[str, jax.Array]:
        if not self.config.human.preferring:
            return {}
        action = jnp.clip(actions["robot"], -1.0, 1.0)
        speed, force = self.task.tool_speed(s, task), norm(s["tool_force"])
        helping = self.task.helping(s, task) if self.spec.preferences_need_help else True
        wanted, before, budget = state.person.preference, state.tool_force, self.spec.preference_budget
        return preference.reward_terms(wanted, speed, force, before, action, budget, helping)

    def _harm(self, s: Sensors, state: EnvState, force):
        """(harm so far, cost of this step)."""
        if state.harm is None:
            return None, jnp.maximum(force / self.config.force_limit - 1.0, 0.0)
        by_region = harm.forces(s)
        return harm.advance(by_region, state.harm, self.dt), harm.cost(by_region)

    def _blocks(self, state: EnvState) -> Blocks:
        s = self.sensors(state.physics)
        of_task = self.task.observe(s, state.task)
        if self.clock:
            of_task["clock"] = self.beat(state)
        blocks = self.sensors.blocks(s, of_task, state.person)
        if self.config.human.expressing:
            speed = self.task.tool_speed(s, state.task)
            blocks["expression"] = expression.expression(state.felt, speed, state.person.preference)
        return blocks

    def _observe(self, state: EnvState) -> Obs:
        blocks = self._blocks(state)
        return {agent: joined(self.sensors.seen_by(agent, blocks)) for agent in AGENTS}

    def _observe_batch(self, done: jax.Array, states: EnvState) -> Obs:
        """Observations [n, ...] where an episode begins, zeros elsewhere: most steps need none beside their own."""
        blank = {agent: jnp.zeros((len(done), size)) for agent, size in self.observation_sizes.items()}
        return map_where(jax.vmap(self._observe), done, blank, states)

    def _measure_layouts(self) -> dict[str, dict[str, slice]]:
        layouts = {}

        def trace(key):
            start = self._draw(key)
            blank = jnp.zeros(self.model.nsensordata)
            physics = PhysicsState(start.qpos, start.qvel, start.qvel, blank, jnp.int32(0), {})
            blocks = self._blocks(self._begin(physics, start, jnp.int32(0)))
            layouts.update({who: self.sensors.layout(who, blocks) for who in (*AGENTS, "global")})

        jax.eval_shape(trace, jax.random.key(0))
        return layouts


MOVES = ("qpos", "qvel", "qacc_warmstart", "sensordata")  # of a PhysicsState, what a step changes
_SEED = 1_000_000  # folded into a reset's key for the state's seed; a split into four may be a fold of 0 to 3


def make(task: str, engine: str = "auto", **settings) -> Env:
    """Make an environment.

    Args:
      task: see `assistax tasks`, for example "scratch".
      engine: "auto", "mujoco", "warp" or "mjx".
      **settings: fields of EnvConfig (`episode_length=500`) or of the task's configuration
        (`success_seconds=1.0`), by name.

    Raises:
      UsageError: an unknown task, engine or setting; the message lists what exists.
    """
    task_config = task_spec(task).config
    task_fields = {f.name for f in dataclasses.fields(task_config)}
    for_task = {name: value for name, value in settings.items() if name in task_fields}
    for_env = {name: value for name, value in settings.items() if name not in task_fields}
    config = with_settings(EnvConfig(), for_env, also=task_fields)
    return Env(task, engine, config, with_settings(task_config, for_task))
