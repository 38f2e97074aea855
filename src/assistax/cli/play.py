"""`assistax play`."""

import sys

from assistax.cli.common import (
    Count,
    File,
    Name,
    Set,
    Switch,
    Task,
    film_episode,
    film_path,
    share_of_success,
    teams_of,
)


def play(
    task: Task,
    *,
    episodes: Count = 16,
    out: File = None,
    engine: Name = None,
    set: Set = (),
    plain: Switch = False,
) -> None:
    """See the trained team that comes with a task: how it does, and a film of it.

    Args:
      task: `assistax tasks` lists them.
      episodes: how many; the film shows the one of median return.
      out: an .mp4, .webp, .gif or .png (default TASK.mp4).
      engine: auto, mujoco, warp or mjx.
      set: change any setting, for example env.human.disability=tremor, as in `assistax evaluate`.
      plain: the film without caption, arrow of the force and spots on the skin.
    """
    from assistax.evaluation.playing import play, summarize

    path = film_path(out)
    print(
        f"Playing {episodes} episodes, then filming one; the first time it compiles for ten seconds.", file=sys.stderr
    )
    env, teams, _ = teams_of(task, "trained", engine, set)
    result = play(env, teams[0], episodes)
    found = summarize(result)
    force = found["force"]
    print(f"{env.name}, the trained team, {episodes} episodes of {env.episode_length * env.dt:g} s")
    print(f"success        {share_of_success(found)}")
    print(f"return         {found['mean_return']:.0f}")
    print(f"force          {force['mean_in_contact']:.1f} N in contact, {force['peak']:.0f} N at most")
    film_episode(result, path, plain)
