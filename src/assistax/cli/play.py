"""`assistax play`."""

from assistax.cli.common import File, Name, Set, Task, film_episode, film_path, print_table, teams_of


def play(
    task: Task,
    *,
    episodes: int = 16,
    out: File = None,
    engine: Name = None,
    set: Set = (),
) -> None:
    """See the trained team that comes with a task: how it does, and a film of it.

    Args:
      task: `assistax tasks` lists them.
      episodes: how many; the film shows the one of median return.
      out: an .mp4, .webp or .png (default TASK.mp4).
      engine: auto, mujoco, warp or mjx.
      set: change any setting, for example env.human.disability=tremor, as in `assistax evaluate`.
    """
    from assistax.evaluation.playing import play, summarize, typical

    path = film_path(out)
    env, teams, about = teams_of(task, "trained", engine, set)
    result = play(env, teams[0], episodes)
    print_table({**about, **summarize(result)})
    film_episode(env, result, typical(result), path)
