"""`assistax train`."""

import shutil
import sys
from typing import Annotated, Any

import tyro

from assistax.cli.common import File, Name, Number, Partner, Set, Switch, Words, free_folder, share_of_success
from assistax.errors import UsageError


def train(
    task: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="TASK", help_behavior_hint="")] = None,
    *,
    algorithm: Name = None,
    recurrent: Switch = False,
    share_parameters: Switch = False,
    steps: Number = None,
    num_envs: Number = None,
    seed: Number = None,
    num_seeds: Number = None,
    engine: Name = None,
    preset: Name = None,
    partner: Partner = (),
    start: File = None,
    out: File = None,
    set: Set = (),
    log: Words = (),
    resume: File = None,
) -> None:
    """Train robot and human together, then evaluate and film them.

    Writes one folder: config.json, metrics.jsonl, evaluations.jsonl, checkpoints/, learning_curve.png,
    summary.json and rollout.mp4. Ctrl-C saves and stops; `--resume RUN` continues where it stopped, to the bit.

    Every setting, with default and meaning, is listed by `assistax settings TASK`: of the algorithm, the environment,
    the person, the task and the training. Change any with --set NAME=VALUE.

    For example:
      assistax train scratch
      assistax train scratch --preset paper --steps 40000000 --num-seeds 3
      assistax train feeding --algorithm mappo --recurrent
      assistax train scratch --set ppo.learning_rate=1e-3 env.torque_scale=0.5
      assistax train scratch --set env.human.disability=tremor+weakness env.human.preference=sweep
      assistax train scratch --partner human=still
      assistax train scratch --partner human=runs/scratch-ippo-0
      assistax train scratch-v1 --partner human=populations/scratch-v1:random/train
      assistax train scratch --start runs/scratch-ippo-0 --set env.human.disability=tremor --steps 1e6
      assistax train --resume runs/scratch-ippo-0

    Args:
      task: what to do together; `assistax tasks` lists them.
      algorithm: ippo (default), mappo, masac or isac.
      recurrent: networks with memory (GRU); ippo and mappo.
      share_parameters: one network for both, which is given who it plays; ippo and mappo.
      steps: environment steps per seed (default 5 million; the paper trains for 40 million).
      num_envs: environments side by side, per seed (default 256; 1024 with the paper's preset of ippo and mappo).
      seed: first random seed (default 0).
      num_seeds: independent runs in one program, with seeds S, S+1, ... (default 1).
      engine: auto (default), mujoco, warp or mjx.
      partner: AGENT=WHO for a frozen partner, who does not learn: a scripted policy, a habit of a person, a run folder
        whose policy (of several seeds, one per episode) plays it as it was trained, or a population or a part of one
        (human=POP:random/train), of which every episode draws a member: body, preferences and policy.
      start: begin with the networks of this run, of one seed and the same task and algorithm, and without teachers.
      preset: hyperparameters: default, or paper for the paper's table.
      out: run folder (default runs/TASK-ALGORITHM-SEED, with a number if taken).
      set: change any setting, for example ppo.gamma=0.98 or task_config.force=2; `assistax settings TASK` lists
        them all with default and meaning. Who the person is, see `assistax humans --help`: env.human.disability,
        .preference, .people, .visibility.
      log: tensorboard or wandb (or both), beside metrics.jsonl; each needs the extra of that name.
      resume: continue this run folder; --steps may prolong it.
    """
    from assistax.files import writing
    from assistax.settings import parse_assignments
    from assistax.training.configuration import configure
    from assistax.training.loggers import check_loggers
    from assistax.training.loop import train as training
    from assistax.training.run import Run

    check_loggers(log)
    if resume is not None:
        given: dict[str, Any] = {"task": task, "algorithm": algorithm, "num-envs": num_envs, "seed": seed}
        given |= {"recurrent": recurrent or None, "share-parameters": share_parameters or None}
        given |= {"num-seeds": num_seeds, "engine": engine, "preset": preset, "out": out, "set": set or None}
        given |= {"partner": partner or None, "start": start}
        if extra := [name for name, value in given.items() if value is not None]:
            raise UsageError(
                f"--resume takes everything but --steps and --log from the run; leave out {', '.join(extra)}."
            )
        run = Run.open(resume, steps=steps)
    else:
        if task is None:
            raise UsageError("Name a task, for example: assistax train scratch. `assistax tasks` lists them.")
        choices: dict[str, Any] = {"algorithm": algorithm, "preset": preset, "engine": engine, "steps": steps}
        choices |= {"num_envs": num_envs, "seed": seed, "num_seeds": num_seeds, "partners": partner}
        choices |= {"recurrent": recurrent, "share_parameters": share_parameters}
        choices |= {"start": str(start)} if start else {}
        config = configure(task, parse_assignments(set), **choices)
        name = f"{task}-{config.algorithm}{'-rnn' * recurrent}{'-shared' * share_parameters}-{config.seed}"
        run = Run.create(config, out or free_folder(name))
    try:
        print(f"{run.config.task} on the {run.env.engine.name} engine, into {run.folder}", file=sys.stderr)
        with writing(run.folder):
            summary = training(run, log=log)
    except KeyboardInterrupt:
        if resume is None and run.newest_checkpoint() is None:
            shutil.rmtree(run.folder, ignore_errors=True)  # nothing is lost
        raise
    if summary is None:
        print(f"Stopped and saved. Continue with: assistax train --resume {run.folder}", file=sys.stderr)
        sys.exit(130)
    print(
        f"return {summary['mean_return']:.0f}, success {share_of_success(summary)} over "
        f"{run.config.evaluation_episodes} evaluation episodes, played without noise (the bar's are of "
        f"training, with noise), {summary['env_steps_per_s']} env steps/s. "
        f"See {run.folder}/learning_curve.png and rollout.mp4."
    )
