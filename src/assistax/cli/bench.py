"""`assistax bench`."""

from assistax.cli.common import Count, Json, Switch, Task, print_json, print_table


def bench(
    task: Task,
    *,
    engine: str = "auto",
    num_envs: Count = 1024,
    seconds: float = 10.0,
    train: Switch = False,
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
    from assistax.diagnostics.bench import bench, bench_training
    from assistax.env import make

    env = make(task, engine)
    report = bench(env, num_envs, seconds)
    if train:
        report |= bench_training(env, num_envs, seconds)
    print_json(report) if json else print_table(report)
