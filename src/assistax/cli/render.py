"""`assistax render`."""

from assistax.cli.common import (
    Count,
    File,
    Name,
    Number,
    Partner,
    Set,
    Switch,
    Target,
    film_episode,
    film_path,
    teams_of,
)


def render(
    target: Target,
    *,
    out: File = None,
    policy: Name = None,
    partner: Partner = (),
    engine: Name = None,
    seed: Number = None,
    set: Set = (),
    width: Count = 640,
    height: Count = 480,
    view: str = "auto",
    plain: Switch = False,
) -> None:
    """Film one episode.

    For example:
      assistax render runs/scratch-ippo-0
      assistax render scratch --policy still --out scratch.png --width 1280 --height 960

    Args:
      target: a run folder, a team file, or a task together with --policy.
      out: an .mp4, .webp or .gif, or a .png of the last moment (default TASK.mp4).
      policy: with a task, who plays: trained (the team that comes with it), still, random, expert or considerate
        (the robot; the human is then still, shows what it is to work on: offer, offer_slowly, or draws back: withdraw).
      partner: AGENT=WHO who plays in place of the team's own, as in `assistax train`: human=shy,
        human=POP:random/test.
      engine: auto, mujoco, warp or mjx (default: as the run, else auto).
      seed: of the episode's draws; fixed unless given.
      set: change any setting of the run or task, as in `assistax evaluate`.
      width: of the picture in pixels.
      height: of the picture in pixels.
      view: camera: auto (from where target and tool are seen most of the time), main (the whole scene) or close.
      plain: without caption, arrow of the force and spots on the skin.
    """
    from assistax.errors import choose
    from assistax.evaluation.playing import EVALUATION_SEED, play

    choose("view", view, ["auto", "main", "close"])
    path = film_path(out, width, height)
    env, teams, _ = teams_of(target, policy, engine, set, partner)
    result = play(env, teams[0], 1, EVALUATION_SEED if seed is None else seed)
    film_episode(result, path, plain, width=width, height=height, view=view)
