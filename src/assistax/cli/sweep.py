"""`assistax sweep`."""

import sys
from typing import Annotated, Any

import tyro

from assistax.cli.common import ExecutorSet, File, Name, Number, Partner, Set, Switch, find_executor, free_folder
from assistax.errors import UsageError

Search = Annotated[
    tuple[str, ...], tyro.conf.arg(name="search", metavar="NAME=LOW:HIGH|A,B ...", help_behavior_hint="")
]


def sweep(
    task: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="TASK", help_behavior_hint="")] = None,
    *,
    algorithm: Name = None,
    recurrent: Switch = False,
    share_parameters: Switch = False,
    configs: Number = None,
    seeds: Number = None,
    steps: Number = None,
    num_envs: Number = None,
    seed: Number = None,
    engine: Name = None,
    preset: Name = None,
    partner: Partner = (),
    search: Search = (),
    set: Set = (),
    out: File = None,
    side_by_side: Number = None,
    resume: File = None,
    processes: Number = None,
    executor: Name = None,
    executor_set: ExecutorSet = (),
) -> None:
    """Search for hyperparameters at random, and rank them by the area under the return curve.

    Writes one folder: sweep.json, trials/CONFIG-SEED/trial.json, ranking.json, sweep.png with a panel per
    hyperparameter, and in the end a sweep_NAME.png for each continuous one as in the paper's appendix. Continuous
    hyperparameters are inputs of one compiled program, so that only the choices cost a compilation each. Ctrl-C saves
    and stops; `--resume SWEEP` continues where it stopped, and machines that share the folder share the work.

    For example:
      assistax sweep scratch
      assistax sweep scratch --algorithm mappo --configs 16 --seeds 3 --steps 1000000
      assistax sweep scratch --search ppo.gamma=0.95:0.999 ppo.num_steps=32,64,128 --set ppo.update_epochs=8
      assistax sweep --resume runs/sweep-scratch-ippo-0 --processes 2

    Args:
      task: what to do together; `assistax tasks` lists them.
      algorithm: ippo (default), mappo, masac or isac.
      recurrent: networks with memory (GRU); ippo and mappo.
      share_parameters: one network for both, which is given who it plays; ippo and mappo.
      configs: how many configurations are drawn (default 168, as in the paper).
      seeds: how many times each is trained (default 12, as in the paper).
      steps: environment steps per trial (default 5 million).
      num_envs: environments side by side, per trial (default 256; 1024 with the paper's preset of ippo and mappo).
      seed: of the draw, and the first one to train with (default 0).
      engine: auto (default), mujoco, warp or mjx.
      preset: what is not searched: default, or paper for the paper's table.
      partner: frozen partners, as in `assistax train`.
      search: instead of or besides the paper's hyperparameters: an interval, drawn log-uniformly if it is above zero,
        or choices.
      set: fix any setting (`assistax settings TASK` lists them), for example ppo.num_minibatches=8; it is then not
        searched.
      out: sweep folder (default runs/sweep-TASK-ALGORITHM-SEED, with a number if taken).
      side_by_side: trials that an accelerator trains at once (default: as many as there are seeds).
      resume: continue this sweep folder.
      processes: so many trainings side by side (default as many as there is room for; 1 is this process).
      executor: local, slurm or ray, as in `assistax population train`.
      executor_set: its settings.
    """
    from assistax.executors.jobs import is_worker
    from assistax.files import writing
    from assistax.settings import parse_assignments
    from assistax.training.configuration import configure
    from assistax.training.search import SEARCH
    from assistax.training.sweep import Sweep

    using = find_executor(processes, executor, executor_set)  # asked before anything is written
    if resume is not None:
        given: dict[str, Any] = {"task": task, "algorithm": algorithm, "configs": configs, "seeds": seeds}
        given |= {"recurrent": recurrent or None, "share-parameters": share_parameters or None, "steps": steps}
        given |= {"num-envs": num_envs, "seed": seed, "engine": engine, "preset": preset, "out": out}
        given |= {
            "side-by-side": side_by_side,
            "partner": partner or None,
            "search": search or None,
            "set": set or None,
        }
        if extra := [name for name, value in given.items() if value is not None]:
            raise UsageError(f"--resume takes everything from the sweep; leave out {', '.join(extra)}.")
        found = Sweep.open(resume)
    else:
        if task is None:
            raise UsageError("Name a task, for example: assistax sweep scratch. `assistax tasks` lists them.")
        choices: dict[str, Any] = {"algorithm": algorithm, "preset": preset, "engine": engine, "steps": steps}
        choices |= {"num_envs": num_envs, "seed": seed, "num_seeds": 12 if seeds is None else seeds}
        choices |= {"partners": partner, "recurrent": recurrent, "share_parameters": share_parameters}
        fixed = parse_assignments(set)
        config = configure(task, fixed, **choices)
        asked = dict(text.partition("=")[::2] for text in search)
        if len(asked) < len(search):
            raise UsageError("--search has a name twice; leave out one.")
        if both := [name for name in asked if name in fixed]:
            raise UsageError(f"{both[0]} is both fixed by --set and searched; leave out one.")
        wanted = {name: text for name, text in SEARCH.get(config.group, {}).items() if name not in fixed} | asked
        name = f"sweep-{task}-{config.algorithm}{'-rnn' * recurrent}{'-shared' * share_parameters}-{config.seed}"
        count = 168 if configs is None else configs
        found = Sweep.create(config, out or free_folder(name), count, wanted, side_by_side)
    print(f"{found.config.task}, {len(found.drawn)} configurations, into {found.folder}", file=sys.stderr)
    with writing(found.folder):
        ranking = found.run() if using is None else found.run_with(using, processes)
    if ranking is None:
        if is_worker():
            return
        print(f"Not finished, and saved. Continue with: assistax sweep --resume {found.folder}", file=sys.stderr)
        sys.exit(130)
    best = ranking[0]
    if best["auc"] is None:
        print(f"Training failed with every configuration; see {found.folder}/trials.")
        return
    settings = " ".join(f"{name}={value}" for name, value in best["settings"].items())
    print(f"Best of {len(ranking)}: area {best['auc']:.0f}, with --set {settings}. See {found.folder}/sweep.png.")
