"""The command line: `assistax --help`."""

import json
import os
import sys
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import arg

from assistax.errors import AssistaxError, UsageError

Task = Annotated[str, tyro.conf.Positional]
Target = Annotated[str, tyro.conf.Positional, arg(metavar="RUN|TASK")]
Json = Annotated[bool, arg(name="json")]
Set = Annotated[tuple[str, ...], arg(name="set", metavar="NAME=VALUE ...")]


def train(
    task: Annotated[str | None, tyro.conf.Positional] = None,
    *,
    algorithm: str | None = None,
    recurrent: bool = False,
    share_parameters: bool = False,
    steps: int | None = None,
    num_envs: int | None = None,
    seed: int | None = None,
    num_seeds: int | None = None,
    engine: str | None = None,
    preset: str | None = None,
    out: Path | None = None,
    set: Set = (),
    resume: Path | None = None,
) -> None:
    """Train robot and human together, then evaluate and film them.

    Writes one folder: config.json, metrics.jsonl, checkpoints/, learning_curve.png, summary.json and
    rollout.mp4. Ctrl-C saves and stops; `--resume RUN` goes on where it stopped, to the bit.

    For example:
      assistax train scratch
      assistax train scratch --preset paper --steps 40000000 --num-seeds 3
      assistax train feeding --algorithm mappo --recurrent
      assistax train scratch --set ppo.learning_rate=1e-3 env.torque_scale=0.5
      assistax train scratch --set env.human.disability=tremor+weakness env.human.preference=sweep
      assistax train --resume runs/scratch-ippo-0

    Args:
      task: what to do together; `assistax tasks` lists them.
      algorithm: ippo (default), mappo, masac or isac.
      recurrent: networks with memory (GRU); ippo and mappo.
      share_parameters: one network for both, told who it plays; ippo and mappo.
      steps: environment steps per seed (default 3 million; the paper trains for 40 million).
      num_envs: environments side by side, per seed (default 1024; masac and isac 256).
      seed: first random seed (default 0).
      num_seeds: independent runs in one program, with seeds S, S+1, ... (default 1).
      engine: auto (default), mujoco, warp or mjx.
      preset: hyperparameters: default, or paper for the paper's table.
      out: run folder (default runs/TASK-ALGORITHM-SEED, with a number if taken).
      set: change any setting in config.json, for example ppo.gamma=0.98 or task_config.force=2. Who the
        person is, see `assistax humans --help`: env.human.disability, .preference, .people, .visibility.
      resume: continue this run folder; --steps may prolong it.
    """
    from assistax.config import parse_assignments
    from assistax.runs import Run, configure

    if resume is not None:
        given: dict[str, Any] = {"task": task, "algorithm": algorithm, "num-envs": num_envs, "seed": seed}
        given |= {"recurrent": recurrent or None, "share-parameters": share_parameters or None}
        given |= {"num-seeds": num_seeds, "engine": engine, "preset": preset, "out": out, "set": set or None}
        if extra := [name for name, value in given.items() if value is not None]:
            raise UsageError(f"--resume takes everything but --steps from the run; leave out {', '.join(extra)}.")
        run = Run.open(resume, steps=steps)
    else:
        if task is None:
            raise UsageError("Name a task, for example: assistax train scratch. `assistax tasks` lists them.")
        choices = {"algorithm": algorithm, "preset": preset, "engine": engine, "steps": steps}
        choices |= {"num_envs": num_envs, "seed": seed, "num_seeds": num_seeds}
        choices |= {"recurrent": recurrent, "share_parameters": share_parameters}
        config = configure(task, parse_assignments(set), **choices)
        name = f"{task}-{config.algorithm}{'-rnn' * recurrent}{'-shared' * share_parameters}-{config.seed}"
        run = Run.create(config, out or _free_folder(name))
    print(f"{run.config.task} on the {run.env.engine.name} engine, into {run.folder}", file=sys.stderr)
    summary = run.train()
    if summary is None:
        print(f"Stopped and saved. Continue with: assistax train --resume {run.folder}", file=sys.stderr)
        sys.exit(130)
    print(
        f"return {summary['mean_return']:.0f}, success {summary['success_rate']:.0%} over 64 episodes, "
        f"{summary['env_steps_per_s']} env steps/s. See {run.folder}/learning_curve.png and rollout.mp4."
    )


def evaluate(
    target: Target,
    *,
    policy: str | None = None,
    episodes: int = 64,
    engine: str | None = None,
    seed: int | None = None,
    set: Set = (),
    json: Json = False,
) -> None:
    """Play whole episodes on fixed seeds; print means with 95 % confidence intervals.

    For example:
      assistax evaluate runs/scratch-ippo-0
      assistax evaluate scratch --policy expert
      assistax evaluate scratch --policy random --json
      assistax evaluate runs/scratch-ippo-0 --set env.human.disability=weakness

    Args:
      target: a run folder, or a task together with --policy.
      policy: with a task, who plays: still, random, expert or considerate (the robot; the human is then still,
        or comes toward the tool: offer, or away from it: withdraw).
      episodes: how many (intervals are over them).
      engine: auto, mujoco, warp or mjx (default: as the run, else auto).
      seed: of the evaluation's draws; fixed unless given.
      set: change any setting of the run or task. Who the person is, see `assistax humans --help`:
        env.human.disability, .preference, .people, .visibility.
      json: print JSON instead of a table.
    """
    from assistax.evaluation import EVALUATION_SEED, play, summarize

    env, teams, about = _teams(target, policy, engine, set)
    start = EVALUATION_SEED if seed is None else seed
    results = [summarize(play(env, team, episodes, start)) for team in teams]
    if json:
        _print_json({**about, **results[0]} if len(results) == 1 else {**about, "seeds": results})
        return
    for result in results:
        _print_table({**about, **result})


def render(
    target: Target,
    *,
    out: Path | None = None,
    policy: str | None = None,
    engine: str | None = None,
    seed: int | None = None,
    set: Set = (),
    width: int = 640,
    height: int = 480,
    view: str = "main",
) -> None:
    """Film one episode.

    For example:
      assistax render runs/scratch-ippo-0
      assistax render scratch --policy still --out scratch.png --width 1280 --height 960

    Args:
      target: a run folder, or a task together with --policy.
      out: an .mp4, or a .png of the last moment (default TASK.mp4).
      policy: with a task, who plays: still, random, expert or considerate (the robot; the human is then still,
        or comes toward the tool: offer, or away from it: withdraw).
      engine: auto, mujoco, warp or mjx (default: as the run, else auto).
      seed: of the episode's draws; fixed unless given.
      set: change any setting of the run or task, as in `assistax evaluate`.
      width: of the picture in pixels.
      height: of the picture in pixels.
      view: camera: main or close.
    """
    from assistax.errors import choose
    from assistax.evaluation import EVALUATION_SEED, play
    from assistax.viewing import check_format, film

    choose("view", view, ["main", "close"])
    if out is not None:
        check_format(out)
        if not out.parent.is_dir():
            raise UsageError(f"The folder {out.parent} of --out does not exist.")
    env, teams, _ = _teams(target, policy, engine, set)
    path = out or Path(f"{env.name}.mp4")
    result = play(env, teams[0], 1, EVALUATION_SEED if seed is None else seed)
    on = result["playing"][0]
    film(
        env.name,
        result["qpos"][0][on],
        result["marker"][0][on],
        env.dt,
        path,
        width=width,
        height=height,
        view=view,
    )
    print(f"wrote {path}")


def gallery(*, out: Path = Path("docs/images")) -> None:
    """Render a picture and a short film of the expert for every task, for the documentation.

    Args:
      out: folder for TASK.png and TASK.webp; must exist.
    """
    from assistax.env import make
    from assistax.evaluation import play, typical
    from assistax.policies import scripted_team
    from assistax.tasks import TASKS
    from assistax.viewing import film

    if not out.is_dir():
        raise UsageError(f"The folder {out} does not exist.")
    for task in TASKS:
        env = make(task)
        result = play(env, scripted_team("expert", env), 9)
        episode = typical(result)
        on = result["playing"][episode]
        qpos, marker = result["qpos"][episode][on], result["marker"][episode][on]
        film(task, qpos, marker, env.dt, out / f"{task}.webp", width=400, height=300)
        half = len(qpos) // 2
        film(task, qpos[:half], marker[:half], env.dt, out / f"{task}.png", width=960, height=640)
        print(f"wrote {out / task}.png and .webp")


def tasks(*, json: Json = False) -> None:
    """List the tasks.

    Args:
      json: print JSON, with the sizes of observations and actions.
    """
    from assistax.env import make
    from assistax.tasks import TASKS

    if not json:
        for name, task in TASKS.items():
            print(f"{name:16} {task.title}")
        return
    listing = {}
    for name, task in TASKS.items():
        env = make(name, engine="mujoco")
        listing[name] = {
            "title": task.title,
            "observations": env.observation_sizes | {"global": env.global_size},
            "actions": env.action_sizes,
            "episode_length": env.config.episode_length,
            "control_period_s": env.dt,
        }
    _print_json(listing)


def humans(*, people: str | None = None, seed: int = 0, json: Json = False) -> None:
    """Say who the person can be: the seven standard disabilities, and a preference in words.

    Any of them can be trained with or evaluated on:
      assistax train scratch --set env.human.disability=tremor+weakness env.human.preference=default
      assistax train scratch --set "env.human.disability=strength=0.5 tremor=0.2 tremor_hz=4 motion=0.7"
      assistax train scratch --set "env.human.preference=speed=0.05:0.09 force=1.2:2 weights=0.3,0.35,-0.03"

    Or drawn at every reset: one of the seven and a preference of the paper's sweep; one of the paper's
    population of 630; one of your own list. The robot may be kept from seeing the preference:
      assistax train scratch --set env.human.disability=standard env.human.preference=sweep
      assistax train scratch --set env.human.people=paper630 env.human.visibility=human
      assistax humans --people paper630 --json > people.json
      assistax train scratch --set env.human.people=people.json

    Args:
      people: list these instead: paper630 or a JSON file.
      seed: of the drawn preference.
      json: print JSON; with --people in the form of such a file.
    """
    import jax

    from assistax.human import DISABILITIES, disability, population, preference

    if people is not None:
        listed = population.people(people)
        if json:
            _print_json([vars(person) for person in listed])
            return
        for i, person in enumerate(listed):
            words = "" if person.preference == "none" else preference.describe(preference.parse(person.preference))
            print(f"{i:4} {person.disability:34} {words}")
        return
    liked = preference.sample(jax.random.key(seed))
    words = preference.describe(liked)
    if json:
        vector = [round(float(x), 4) for x in preference.vector(liked)]
        ranges = {"disability": disability.RANGES, "preference": preference.RANGES, "weights": preference.WEIGHTS}
        drawn = {"preference": vector, "spelling": preference.spell(liked), "words": words}
        _print_json({"disabilities": DISABILITIES, "ranges": ranges, **drawn})
        return
    for name, parts in DISABILITIES.items():
        print(f"{name:34} {' '.join(f'{part}={value:g}' for part, value in parts.items())}")
    print(f"\nperson {seed} {words}")


def doctor(*, json: Json = False) -> None:
    """Say what is installed, which engine is used and why; step and render for two seconds.

    Args:
      json: print JSON.
    """
    from assistax.doctor import diagnose

    report = diagnose()
    if json:
        _print_json(report)
    else:
        _print_table(report)
    if "FAILED" in report["self_test"] + report["rendering"]:
        sys.exit(1)


def bench(
    task: Task,
    *,
    engine: str = "auto",
    num_envs: int = 1024,
    seconds: float = 10.0,
    train: bool = False,
    json: Json = False,
) -> None:
    """Measure speed on this machine: the environment beside its bare physics engine.

    Args:
      task: `assistax tasks` lists them.
      engine: auto, mujoco, warp or mjx.
      num_envs: environments side by side.
      seconds: how long to measure, after compilation.
      train: also time IPPO training with the paper's preset.
      json: print JSON.
    """
    from assistax.bench import bench, bench_training
    from assistax.env import make

    env = make(task, engine)
    report = bench(env, num_envs, seconds)
    if train:
        report |= bench_training(env, num_envs, seconds)
    _print_json(report) if json else _print_table(report)


def main() -> None:
    """Entry point of the `assistax` command."""
    commands: dict[str, Any] = {f.__name__: f for f in (train, evaluate, render, gallery, tasks, humans, doctor, bench)}
    # Programs without physics are compiled once per machine; read when JAX is first imported.
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "assistax" / "jax"
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache))
    try:
        tyro.extras.subcommand_cli_from_dict(
            commands,
            prog="assistax",
            description="A robot arm and a person, both with policies of their own: train, evaluate, watch.",
            config=(tyro.conf.FlagCreatePairsOff,),
        )
    except AssistaxError as error:
        print(f"assistax: {error}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:  # the reader has seen enough, as in `assistax humans --people paper630 | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _teams(target: str, policy: str | None, engine: str | None, assignments: tuple[str, ...]):
    """(env, teams by seed, what they are) of a run folder or of a task with a scripted policy."""
    from assistax.config import parse_assignments
    from assistax.env import Env
    from assistax.policies import scripted_team
    from assistax.runs import Run, configure
    from assistax.tasks import TASKS

    settings = parse_assignments(assignments)
    if policy is not None:
        config = configure(target, settings, engine=engine)
        env = Env(target, config.engine, config.env, config.task_config)
        return env, [scripted_team(policy, env)], {"task": target, "policy": policy}
    if not Path(target).is_dir():
        if target in TASKS:
            raise UsageError(f"Say who plays {target}: --policy still, random, expert, ..., or give a run folder.")
        raise UsageError(f"{target!r} is neither a run folder nor a task ({', '.join(TASKS)}) with --policy.")
    run = Run.open(Path(target), settings, engine=engine)
    return run.env, run.teams(), {"task": run.config.task, "run": target}


def _free_folder(name: str) -> Path:
    folder, number = Path("runs") / name, 2
    while folder.exists():
        folder, number = Path("runs") / f"{name}-{number}", number + 1
    return folder


def _print_json(report: Any) -> None:
    print(json.dumps(report, indent=2))


def _print_table(report: dict[str, Any], indent: str = "") -> None:
    for name, value in report.items():
        if isinstance(value, dict):
            print(f"{indent}{name}")
            _print_table(value, indent + "  ")
        else:
            if isinstance(value, (list, tuple)):
                value = " to ".join(f"{x:.4g}" if isinstance(x, float) else str(x) for x in value)
            elif isinstance(value, float):
                value = f"{value:.4g}"
            print(f"{indent}{name:{28 - len(indent)}} {value}")


if __name__ == "__main__":
    main()
