"""The pages of the tasks in docs/tasks/, from the tasks' own settings; tools/pages.py writes them."""

import dataclasses
import re
import textwrap
from math import degrees, pi
from pathlib import Path
from typing import Any

import jax
from task_pictures import draw
from task_words import BOLTZMANN, TASKS, Words

from assistax import scenes
from assistax.cli.settings import meanings
from assistax.env import AGENTS, Env, EnvConfig, make
from assistax.human import harm, preference
from assistax.results.comparison import markdown
from assistax.scenes.build import BRAKE_FROM
from assistax.tasks import TASKS as VERSIONS
from assistax.tasks import TaskSpec, rewards, task_spec

FOLDER, PICTURES = Path("docs/tasks"), Path("docs/images/tasks")
STEPS = 1000  # of the episodes that bounds are for

BLOCKS = {  # by block of an observation its unit and what it is
    "theta_robot": ("rad", "angles of the robot's joints, from the base to the hand"),
    "dtheta_robot": ("rad/s", "their speeds"),
    "tool_pos": ("m", "the tool point"),
    "tool_quat": ("", "orientation of the tool, a quaternion w, x, y, z"),
    "tool_force": ("N", "net force of the tool's working surface on the person"),
    "theta_human": ("rad", "angles of the person's joints: {joints}"),
    "dtheta_human": ("rad/s", "their speeds"),
    "forearm_pos": ("m", "where the right forearm begins, the elbow"),
    "upper_arm_pos": ("m", "where the right upper arm begins, the shoulder"),
    "mouth_pos": ("m", "the middle of the mouth"),
    "target_vector": ("m", "from the tool point to the target"),
    "target_distance": ("m", "its length"),
    "target_normal": ("", "direction out of the skin at the target, a unit vector"),
    "target_axis": ("", "direction along the limb at the target, a unit vector"),
    "target_rotation": ("", "orientation of the target as the tool sees it, a matrix row by row"),
    "arm_axes": ("", "unit vectors along upper arm and forearm"),
    "dirt_vectors": ("m", "from the tool point to the middle of what is still dirty, on upper arm and forearm"),
    "dirt_normals": ("", "mean directions out of the skin where it is still dirty, on upper arm and forearm"),
    "dirt_left": ("", "of all that was dirty, the shares that still are, on upper arm and forearm"),
    "dirty_side": ("", "cosine and sine of the angle around the limb at which there was dirt, their means"),
    "waist_vector": ("m", "from the middle of the forearm to the waist target"),
    "waist_distance": ("m", "its length"),
    "target_velocity": ("m/s", "velocity of the target"),
    "clock": ("", "sine and cosine of the phase of a clock of {clock:g} Hz that begins with the episode"),
    "thrown": ("", "1 if the arm moved too fast for help since it last lay still away from the waist, otherwise 0"),
}
SPEC_FIELDS = {  # what versions may differ in beside settings, and how it is told
    "bound": "bound of the return",
    "clock": "Hz, of the clock that the robot sees",
    "preferences_need_help": "preferences pay for speed and force only while it helps",
    "tremor_weakens": "a weak person trembles less, too",
    "rest_pays": "reward term that an early end pays for the steps that are left",
}
SCENE_FIELDS = {
    "start": "joint angles at which the robot starts, rad",
    "worked_on": "body parts that see the tool's speed and force",
    "regions": "harm is measured by region of the body",
    "throat": "the robot touches the throat, and does not go through it",
    "speed_limits": "joints keep to their speed limits",
    "supported": "furniture holds arms that are not driven",
}

TEMPLATES = Path(__file__).parent / "templates"
WIDTH = 120  # of a line


def pages() -> dict[Path, str]:
    """By file the text of every page."""
    envs = {name: make(name, engine="mujoco") for name in TASKS}
    texts = {FOLDER / f"{name}.md": page(env, TASKS[name]) for name, env in envs.items()}
    return {FOLDER / "index.md": index(list(envs.values())), **texts}


def pictures() -> dict[Path, bytes]:
    """By file the picture of every page; plays an episode of each task."""
    return {PICTURES / f"{name}.png": draw(task_spec(name).id, words.picture) for name, words in TASKS.items()}


def page(env: Env, words: Words) -> str:
    """The page of the newest version of one task."""
    spec, config, shared = env.spec, env.task_config, env.config
    every = sorted((one for one in VERSIONS.values() if one.name == spec.name), key=lambda one: -one.version)
    paper = every[-1]
    numbers = {"c": config, "r": rewards, "deg": _Degrees(config), "B": BOLTZMANN}
    largest = {name: term.most(config, STEPS) for name, term in words.terms.items()}
    _check_terms(env, words)
    total, bound = sum(largest.values()), spec.bound or 0.0
    fields = {name: getattr(words, name).format(**numbers) for name in ("helps", "success", "draws", "where")}
    formulas = {name: term.formula.format(**numbers) for name, term in words.terms.items()}
    if any("[helps" in formula for formula in formulas.values()):
        fields["where"] += "; [helps]: 1 while it helps, as below, and 0 otherwise"
    fields["where"] = "\n".join(f"- {sign}" for sign in fields["where"].split("; "))
    rows = [[f"`{name}`", f"`{formula}`", f"{largest[name]:.0f}"] for name, formula in formulas.items()]
    printed = f"what the paper prints as the most that an episode of {STEPS} steps can return"
    changed = f"higher than the paper's {paper.bound:g}, as one term is not the paper's"
    return _filled(
        "task",
        title=spec.title,
        id=spec.id,
        version=spec.version,
        name=spec.name,
        story=words.story,
        picture=f"../{(PICTURES / f'{spec.name}.png').relative_to('docs')}",
        tool=words.tool,
        observations=observations(env),
        preference=preference.SIZE,
        actions=actions(env),
        terms=markdown(["term", "formula", f"at most, in {STEPS} steps"], rows),
        bound=f"{bound:g}",
        whose=printed if bound == paper.bound else changed,
        sum=total,
        over=", so that returns above the bound are possible" if total > 1.01 * bound else "",
        budget=spec.preference_budget,
        harm=_harm_here(words.touched),
        length=shared.episode_length,
        seconds=shared.episode_length * env.dt,
        end=words.end,
        noise=shared.reset_noise,
        settings=settings(config, {f"version {one.version}": one.config for one in every}),
        before=words.before,
        versions=versions(spec, paper),
        between=f"{words.between}\n\n" * bool(words.between),
        **fields,
    )


def index(envs: list[Env]) -> str:
    """What all tasks share, and the way to their pages."""
    env = envs[0]
    shared, arm = env.config, env.robot
    rows = []
    for e in envs:
        sizes = [f"{e.observation_sizes[agent]} / {e.action_sizes[agent]}" for agent in AGENTS]
        rows.append([f"[{e.spec.name}]({e.spec.name}.md)", e.spec.title, *sizes, str(e.global_size)])
    limits = [[f"`{name}`", *(f"{x:g}" for x in region[:3])] for name, region in harm.REGIONS.items()]
    return _filled(
        "tasks",
        tasks=markdown(["task", "", *(f"{agent}: observation / action" for agent in AGENTS), "global"], rows),
        substeps=shared.substeps,
        physics=1e3 * env.dt / shared.substeps,
        control=1e3 * env.dt,
        length=shared.episode_length,
        seconds=shared.episode_length * env.dt,
        scale=shared.torque_scale,
        torque=_listed(arm.torque),
        human=scenes.HUMAN_TORQUE,
        speed=_listed(arm.speed),
        limits=" and ".join(
            f"{scenes.HUMAN_SPEED[joints[0]]:g} ({part})"
            for part, joints in {"arm": scenes.RIGHT_ARM, "neck": scenes.NECK}.items()
        ),
        brake=BRAKE_FROM,
        harm=markdown(["region", "comfort, N", "clamping, N", "impact, N"], limits),
        filter=1e3 * harm.FILTER_SECONDS,
        clamping=harm.CLAMPING_SECONDS,
        settings=settings(EnvConfig()),
    )


def observations(env: Env) -> str:
    """Every block with its slices, unit and meaning."""
    layouts = {who: env.obs_layout(who) for who in (*AGENTS, "global")}
    joints = ", ".join(f"`{name}`" for name in scenes.HUMAN_JOINTS)
    rows = []
    for name in layouts["global"]:
        unit, meaning = BLOCKS[name]
        places = [layout.get(name) for layout in layouts.values()]
        slices = [f"{place.start}:{place.stop}" if place else "–" for place in places]
        rows.append([f"`{name}`", *slices, unit, meaning.format(joints=joints, clock=env.clock)])
    sizes = [str(env.observation_sizes[agent]) for agent in AGENTS]
    rows.append(["in all", *sizes, str(env.global_size), "", ""])
    return markdown(["block", *layouts, "unit", "what it is"], rows)


def actions(env: Env) -> str:
    """In words."""
    scene, sizes = env.spec.scene, env.action_sizes
    full = _listed([env.config.torque_scale * limit for limit in env.robot.torque])
    driven = ", ".join(f"`{name}`" for name in scene.human_driven)
    strongest = scene.human_strength * scenes.HUMAN_TORQUE
    return (
        f"- robot [{sizes['robot']}]: torques of the arm's joints on top of gravity compensation, full action {full} "
        f"N m\n"
        f"- human [{sizes['human']}]: torques of {driven}, full action {strongest:g} N m"
    )


def settings(config: Any, versions: dict[str, Any] | None = None) -> str:
    """Every field with its default, or its value in each of the versions by their names, and its comment."""
    shown = versions or {"default": config}
    told, rows = meanings(type(config)), []
    for field in dataclasses.fields(config):
        if dataclasses.is_dataclass(getattr(config, field.name)):
            continue
        values = [_shown(getattr(one, field.name)) for one in shown.values()]
        rows.append([f"`{field.name}`", *values, told[field.name]])
    return markdown(["setting", *shown, "meaning"], rows)


def versions(spec: TaskSpec, paper: TaskSpec) -> str:
    """What two versions differ in beside their settings."""
    rows = []
    for fields, new, old in ((SPEC_FIELDS, spec, paper), (SCENE_FIELDS, spec.scene, paper.scene)):
        for name, meaning in fields.items():
            values = [_shown(getattr(one, name)) for one in (old, new)]
            if values[0] != values[1]:
                rows.append([meaning, *values])
    return markdown(["", "version 0", f"version {spec.version}"], rows)


def _check_terms(env: Env, words: Words) -> None:
    def step(key):
        actions = {agent: jax.numpy.zeros(size) for agent, size in env.action_sizes.items()}
        return env.step_env(key, env.reset(key)[1], actions)[-1]["reward_terms"]

    terms = set(jax.eval_shape(step, jax.random.key(0)))
    assert terms == set(words.terms), f"{env.name} has the terms {sorted(terms)}, tools/task_words.py others"


def _harm_here(regions: tuple[str, ...]) -> str:
    told = []
    for name in regions:
        limits = harm.REGIONS[name]
        told.append(f"{name.replace('_', ' ')} ({limits.clamping:g} N clamping, {limits.impact:g} N impact)")
    return ", ".join(told)


class _Degrees:
    """A configuration's angles in whole degrees, by field."""

    def __init__(self, config: Any):
        self._config = config

    def __getitem__(self, name: str) -> str:
        value = getattr(self._config, name)
        return " to ".join(f"{degrees(x):.0f}" for x in (value if isinstance(value, tuple) else (value,)))


def _filled(template: str, **fields: Any) -> str:
    """A template with its fields, paragraphs and lists in lines of WIDTH."""
    blocks = (TEMPLATES / f"{template}.md").read_text().format(**fields).strip().split("\n\n")
    return "\n\n".join(_wrapped(block) for block in blocks) + "\n"


def _wrapped(block: str) -> str:
    if block.startswith(("#", "|", "!")):
        return block
    items = re.split(r"\n(?=- )", block)
    return "\n".join(
        textwrap.fill(
            " ".join(item.split()),
            WIDTH,
            subsequent_indent="  " * item.startswith("- "),
            break_long_words=False,
            break_on_hyphens=False,
        )
        for item in items
    )


def _shown(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "none"}[value]
    if isinstance(value, tuple):
        return ", ".join(_shown(x) for x in value) or "none"
    return "π" if value == pi else f"{value:.4g}" if isinstance(value, float) else str(value)


def _listed(values) -> str:
    return ", ".join(f"{x:g}" for x in values)
