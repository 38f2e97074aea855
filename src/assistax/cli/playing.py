"""`assistax play`, `evaluate`, `render` and `export`."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from assistax.cli.common import Json, Set, Target, Task, print_json, print_table, teams_of
from assistax.errors import UsageError


def play(
    task: Task,
    *,
    episodes: int = 16,
    out: Path | None = None,
    engine: str | None = None,
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

    path = _film_path(out)
    env, teams, about = teams_of(task, "trained", engine, set)
    result = play(env, teams[0], episodes)
    print_table({**about, **summarize(result)})
    _film(env, result, typical(result), path)


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
      target: a run folder, a team file, or a task together with --policy.
      policy: with a task, who plays: trained (the team that comes with it), still, random, expert or considerate
        (the robot; the human is then still, or comes toward the tool: offer, or away from it: withdraw).
      episodes: how many (intervals are over them).
      engine: auto, mujoco, warp or mjx (default: as the run, else auto).
      seed: of the evaluation's draws; fixed unless given.
      set: change any setting of the run or task. Who the person is, see `assistax humans --help`:
        env.human.disability, .preference, .people, .visibility.
      json: print JSON instead of a table.
    """
    from assistax.evaluation.playing import EVALUATION_SEED, play, summarize

    env, teams, about = teams_of(target, policy, engine, set)
    start = EVALUATION_SEED if seed is None else seed
    results = [summarize(play(env, team, episodes, start)) for team in teams]
    if json:
        print_json({**about, **results[0]} if len(results) == 1 else {**about, "seeds": results})
        return
    for result in results:
        print_table({**about, **result})


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
      target: a run folder, a team file, or a task together with --policy.
      out: an .mp4, a .webp, or a .png of the last moment (default TASK.mp4).
      policy: with a task, who plays: trained (the team that comes with it), still, random, expert or considerate
        (the robot; the human is then still, or comes toward the tool: offer, or away from it: withdraw).
      engine: auto, mujoco, warp or mjx (default: as the run, else auto).
      seed: of the episode's draws; fixed unless given.
      set: change any setting of the run or task, as in `assistax evaluate`.
      width: of the picture in pixels.
      height: of the picture in pixels.
      view: camera: main or close.
    """
    from assistax.errors import choose
    from assistax.evaluation.playing import EVALUATION_SEED, play

    choose("view", view, ["main", "close"])
    path = _film_path(out)
    env, teams, _ = teams_of(target, policy, engine, set)
    result = play(env, teams[0], 1, EVALUATION_SEED if seed is None else seed)
    _film(env, result, 0, path, width=width, height=height, view=view)


def export(run: Annotated[Path, tyro.conf.Positional], *, out: Path, seed: int | None = None) -> None:
    """Write the trained team of a run into one small file, which plays without the run folder.

    Args:
      run: a run folder.
      out: NAME.safetensors.
      seed: which of the run's seeds (default the first).
    """
    from assistax.training.run import Run
    from assistax.training.team_file import save_team

    found = Run.open(run)
    seeds = list(found.seeds.seeds)
    if seed is not None and seed not in seeds:
        raise UsageError(f"{run} has no seed {seed}; it has {', '.join(map(str, seeds))}.")
    seed = seeds[0] if seed is None else seed
    save_team(out, found.teams()[seeds.index(seed)], dataclasses.replace(found.config, seed=seed))
    print(f"wrote {out}")


def _film_path(out: Path | None) -> Path | None:
    """`out`, if a film can go there; asked before anything is played."""
    from assistax.evaluation.film import check_format

    if out is not None:
        check_format(out)
        if not out.parent.is_dir():
            raise UsageError(f"The folder {out.parent} of --out does not exist.")
    return out


def _film(env, result, episode: int, path: Path | None, **camera) -> None:
    """Film one episode of what a Player returned; without a path into TASK.mp4."""
    from assistax.evaluation.film import film

    path = path or Path(f"{env.name}.mp4")
    on = result["playing"][episode]
    film(env.name, result["qpos"][episode][on], result["marker"][episode][on], env.dt, path, **camera)
    print(f"wrote {path}")
